"""Sensitivity: Ishigami's function, a scene with a closed form, noise over seeds, errors."""

import csv
import io
import json
import math

import matplotlib as mpl
import numpy as np
import pytest
from click.testing import CliRunner
from studied import in_this_process

import multicell as mc
from multicell.calibration.sensitivity.analysis import plan_sensitivity, sample_sensitivity
from multicell.calibration.sensitivity.indices import sample, sensitivity_indices
from multicell.cli.main import main
from multicell.errors import OutputError, SceneError
from multicell.studies import engine
from multicell.studies.axes import parse_ranges

CELL = mc.Scene.from_dict(
    {"title": "One cell", "duration": "10 min", "coupling_step": "5 min", "initial": {"count": 1},
     "output": {"every": "10 min"}}
)  # fmt: skip
FREE = {
    "cells.division_radius": "5:8 um",
    "cells.young": "0.5:2 kPa",
    "drag.viscosity": "log 0.1:10 kPa s",
}
ONE = {"cells.division_radius": "5:8 um"}
FOUR = {**FREE, "cells.poisson": "0.2:0.4"}


def ishigami(shares, a=7.0, b=0.1):
    """Return Ishigami's function of the first three parameters, -pi to pi."""
    x, y, z = (math.pi * (2.0 * shares[:, k] - 1.0) for k in range(3))
    return np.sin(x) + a * np.sin(y) ** 2 + b * z**4 * np.sin(x)


def of_function(size, seeds=1, noise=0.0, shift=0.0, lost=()):
    """Return the analysis of Ishigami's function in place of runs."""
    rng = np.random.default_rng(3)
    ranges = parse_ranges(FOUR, CELL)
    shares = sample([free.name for free in ranges], size)
    values = np.repeat(ishigami(shares)[:, None], seeds, axis=1)
    values += noise * rng.standard_normal(values.shape) + shift * np.arange(seeds)
    for place in lost:
        values[place] = np.nan
    return sample_sensitivity(CELL, ranges, range(seeds), {"diameter": values})


def column(result, name):
    return np.array([row[name] for row in result.table])


def test_morris_finds_what_has_no_effect_and_what_interacts():
    result = of_function(40)
    assert column(result, "mu_star")[3] == 0.0
    assert column(result, "sigma")[3] == 0.0
    # on the grid y, of sin² 0 or 3/4, always moves by 3/4, and x, of sine, by the root of that
    assert column(result, "mu_star")[1] == pytest.approx(1.5 * 7.0 * 0.75)
    wanted = 1.5 * math.sqrt(0.75) * (1.0 + 0.1 * math.pi**4 * (1.0 + 3.0**-4) / 2.0)
    assert abs(column(result, "mu")[0] - wanted) < column(result, "mu_star_conf")[0]
    # z acts only through its product with sin(x): its effects have both signs
    assert abs(column(result, "mu")[2]) < 0.5 * column(result, "mu_star")[2]
    assert column(result, "sigma")[2] > column(result, "mu_star")[2]


def test_effects_of_a_linear_function_are_its_slopes():
    names = ["a", "b", "c"]
    shares = sample(names, 8)
    found = sensitivity_indices(names, shares, (shares @ [3.0, -2.0, 0.0])[:, None])
    expected = {"mu": [3.0, -2.0, 0.0], "mu_star": [3.0, 2.0, 0.0], "sigma": [0.0] * 3}
    for name, values in {**expected, "mu_star_conf": [0.0] * 3}.items():
        assert found.columns[name] == pytest.approx(values, abs=1e-12)


def test_noise_is_known_and_hides_what_has_no_effect():
    seeds, noise = 4, 1.0
    result = of_function(40, seeds, noise)
    # differences of two means over the seeds have this variance; a step is 2/3 of the range
    wanted = 1.5 * math.sqrt(2.0 / math.pi * 2.0 * noise**2 / seeds)
    assert column(result, "noise") == pytest.approx(np.full(4, wanted), rel=0.2)
    hidden = "not distinguishable from noise"
    assert [row["verdict"] for row in result.table] == [*["clear"] * 3, hidden]


def test_what_all_points_share_of_a_seed_is_no_noise():
    result = of_function(10, seeds=3, shift=5.0)
    assert column(result, "noise") == pytest.approx(np.zeros(4), abs=1e-12)
    assert column(result, "mu_star") == pytest.approx(column(of_function(10), "mu_star"))


def test_one_seed_leaves_the_noise_unknown():
    result = of_function(40)
    assert np.isnan(column(result, "noise")).all()
    assert result.table[0]["verdict"] == "clear of zero, noise unknown"
    assert result.table[3]["verdict"] == "not distinguishable from zero"
    assert any("the noise is unknown" in note for note in result.notes)


def test_a_larger_sample_begins_with_the_smaller_one():
    names = ["a", "b", "c"]
    small, large = sample(names, 12), sample(names, 24)
    np.testing.assert_array_equal(large[: len(small)], small)


def test_trajectories_that_lack_a_run_are_left_out():
    result = of_function(20, lost=[0, 13, 14])  # of trajectories 0, 2 and 2
    assert any("2 of 20 trajectories lack a run" in note for note in result.notes)
    names = [free.name for free in result.ranges]
    shares = sample(names, 20)
    kept = np.delete(shares.reshape(20, 5, 4), [0, 2], axis=0).reshape(-1, 4)
    wanted = sensitivity_indices(names, kept, ishigami(kept)[:, None])
    assert column(result, "mu_star").tolist() == wanted.columns["mu_star"].tolist()


def test_seeds_that_lack_a_run_are_left_out_of_their_trajectory_alone():
    names = ["a"]
    shares = sample(names, 6)
    values = np.stack([shares[:, 0], shares[:, 0] + 100.0], axis=1)
    values[0, 1] = np.nan
    found = sensitivity_indices(names, shares, values)
    assert found.used == 6
    assert found.columns["mu"][0] == pytest.approx(1.0)


def test_without_values_nothing_is_claimed():
    result = of_function(8, lost=range(40))
    assert {row["verdict"] for row in result.table} == {"unknown"}
    assert any("no index is known" in note for note in result.notes)


def asked(folder, free=ONE, **options):
    given = {"size": 4, "observables": ["diameter"], "output": folder, "report": False}
    return mc.sensitivity(CELL, free, **(given | options))


@pytest.fixture(scope="module")
def analysis(tmp_path_factory):
    """Return the analysis of one cell, over two seeds, and its folder."""
    folder = tmp_path_factory.mktemp("analysis")
    with pytest.MonkeyPatch.context() as monkeypatch:
        in_this_process(monkeypatch)
        return asked(folder, FREE, seeds=2), folder


@pytest.mark.slow
def test_the_diameter_of_one_cell_depends_on_its_size_alone(analysis):
    result, _ = analysis
    # a young cell has half the volume of one that divides
    wanted = 2.0 * (8.0 - 5.0) / 2.0 ** (1.0 / 3.0)
    row = result.index("diameter", "cells.division_radius")
    assert row["mu"] == pytest.approx(wanted, rel=1e-9)
    assert row["mu_star_conf"] == pytest.approx(0.0, abs=1e-9)
    assert row["verdict"] == "clear"
    for other in ("young", "viscosity"):
        assert result.index("diameter", other)["mu_star"] == 0.0
        assert result.index("diameter", other)["verdict"] == "not distinguishable from zero"
    with pytest.raises(SceneError, match="Did you mean 'viscosity'"):
        result.index("diameter", "viscosty")


def test_nothing_is_computed_twice(tmp_path, here):
    asked(tmp_path)
    first = len(here)
    assert first == len(set(here))
    asked(tmp_path)
    assert len(here) == first
    asked(tmp_path, size=6, seeds=2, observables=["largest_pressure"])
    names = {path.name for path in (tmp_path / "runs").iterdir()}
    assert len(here) == len(names)


def test_an_analysis_is_a_study_whose_runs_can_be_looked_at(analysis):
    result, folder = analysis
    study = mc.load_study(folder)
    assert {state.state for state in study.status()} == {"done"}
    plan = plan_sensitivity(CELL, FREE, size=4, seeds=2, observables=["diameter"])
    ends = study.to_xarray()["diameter"].isel(time=-1).values[list(plan.rows)]
    again = sample_sensitivity(CELL, plan.ranges, plan.seeds, {"diameter": ends})
    assert again.table == result.table


def test_points_of_a_sample_that_are_the_same_are_one_point_of_the_study():
    plan = plan_sensitivity(CELL, ONE, size=8)
    values = [point.coordinates["division_radius"] for point in plan.study.points]
    assert len(values) == len(set(values)) <= 4  # the levels of the grid of Morris
    own = sample(["division_radius"], 8)[:, 0]
    wanted = [plan.ranges[0].value(share) for share in own]
    assert [values[row] for row in plan.rows] == wanted


def test_another_question_in_the_folder_is_refused(tmp_path, here):
    asked(tmp_path)
    with pytest.raises(OutputError, match="would not be widened, but changed"):
        asked(tmp_path, {"cells.young": "0.5:2 kPa"})
    with pytest.raises(OutputError, match="holds a study of another scene"):
        mc.sensitivity(CELL.with_changes({"cells.young": "2 kPa"}), ONE, size=4, output=tmp_path)
    asked(tmp_path, {"cells.young": "0.5:2 kPa"}, overwrite=True)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "file").write_text("")
    with pytest.raises(OutputError, match="is not empty"):
        asked(tmp_path / "other")


def test_a_run_that_fails_is_told_and_left_out(tmp_path, here, monkeypatch):
    inner = engine.run_study

    def failing(runs, folder, **options):
        from dataclasses import replace

        outcomes = inner(runs, folder, **options)
        return [replace(outcomes[0], state="failed", reason="step failed: no way"), *outcomes[1:]]

    monkeypatch.setattr(engine, "run_study", failing)
    result = asked(tmp_path)
    assert any("1 runs failed, the first one: step failed: no way" in n for n in result.notes)
    assert list(result.failures.values()) == ["step failed: no way"]
    row = result.index("diameter", "division_radius")
    assert row["mu"] == pytest.approx(6.0 / 2.0 ** (1.0 / 3.0))


BAD = {
    "unknown observable": ({"observables": ["diametre"]}, "Did you mean 'diameter'"),
    "too few": ({"size": 3}, "must be a whole number from 4"),
    "of another scene": ({"observables": ["pull"]}, "have no 'pull'"),
}


@pytest.mark.parametrize("case", BAD)
def test_what_cannot_be_asked_is_refused_before_anything_runs(case, tmp_path, here):
    changed, words = BAD[case]
    given = {"free": FREE, "size": 4, "observables": ["diameter"], "output": tmp_path / "out"}
    with pytest.raises(SceneError, match=words):
        mc.sensitivity(CELL, **(given | changed))
    assert not here
    assert not (tmp_path / "out").exists()


def test_values_that_the_scene_refuses_are_told_with_their_point(tmp_path, here):
    free = {"contact.smoothing": "0:100 um"}
    with pytest.raises(SceneError, match=r"contact\.smoothing.*100"):
        mc.sensitivity(CELL, free, size=4, output=tmp_path / "out")


def command(folder, *more):
    path = folder / "cell.toml"
    path.write_text(CELL.to_toml())
    free = [part for key, text in FREE.items() for part in ("--free", f"{key}={text}")]
    return CliRunner().invoke(
        main,
        ["sensitivity", str(path), *free, "--size", "4", "-o", str(folder / "out"), *more],
    )


@pytest.mark.slow
def test_the_command_writes_tables_pictures_and_a_page(tmp_path, here):
    done = command(tmp_path, "--seeds", "2", "--observable", "diameter", "--json")
    assert done.exit_code == 0, done.output
    document = json.loads(done.stdout)
    assert document["table"][0]["parameter"] == "division_radius"
    files = {path.name for path in (tmp_path / "out").iterdir()}
    assert {
        "report.html",
        "sensitivity.csv",
        "sensitivity.json",
        "sensitivity-diameter.png",
    } <= files
    rows = list(csv.DictReader(io.StringIO((tmp_path / "out" / "sensitivity.csv").read_text())))
    assert float(rows[0]["mu_star"]) == pytest.approx(document["table"][0]["mu_star"])
    html = (tmp_path / "out" / "report.html").read_text("utf-8")
    assert "division radius" in html
    assert "http" not in html.replace("http-equiv", "")


@pytest.mark.slow
def test_the_command_takes_an_observable_of_the_users_own_and_tells_the_table(tmp_path, here):
    file = tmp_path / "mine.py"
    file.write_text(
        "import multicell as mc\n\n"
        "@mc.observable(name='twice the radius', unit='um')\n"
        "def twice(state):\n"
        "    return 2.0 * float(state.cells.radius[0])\n"
    )
    asking = ("--observable", f"{file}:twice", "--observable", "diameter", "--no-report")
    done = command(tmp_path, *asking, "--json")
    assert done.exit_code == 0, done.output
    rows = json.loads(done.stdout)["table"]
    own, known = (
        [row["mu"] for row in rows if row["observable"] == name]
        for name in ("twice_the_radius", "diameter")
    )
    assert own == pytest.approx(known)
    count = len(here)
    done = command(tmp_path, *asking)  # in words, asking nothing of what is short
    assert len(here) == count
    assert done.exit_code == 0, done.output
    assert "division_radius" in done.stdout
    assert "one seed: the noise is unknown" in done.stdout


def test_what_is_expected_to_take_long_is_asked_for(tmp_path, here):
    done = command(tmp_path, "--set", "initial.count=100000", "--set", "duration=100 d")
    assert done.exit_code == 2
    assert "--yes confirms" in done.output
    assert not here


def test_pictures_show_every_index_with_its_interval():
    result = of_function(10, seeds=2, noise=0.5)
    figure = result.plot("diameter")
    words = [t.get_text() for t in figure.findobj(mpl.text.Text)]
    for name in ("division radius", "young", "drag viscosity", "poisson"):
        assert name in words
    axes = figure.axes[0]
    widths = sorted(bar.get_width() for bar in axes.patches)
    assert widths == pytest.approx(sorted(column(result, "mu_star")))
    bars = [bar for bar in axes.containers if hasattr(bar, "has_xerr")]
    lengths = sorted(
        np.ptp(segment[:, 0]) for bar in bars for segment in bar.lines[2][0].get_segments()
    )
    assert lengths == pytest.approx(sorted(2.0 * column(result, "mu_star_conf")))


def test_the_plane_of_morris_has_a_point_for_each_parameter():
    result = of_function(10, seeds=2, noise=0.5)
    plane = result.plot("diameter").axes[1]
    points = np.concatenate([line.get_xydata() for line in plane.lines if line.get_marker() == "o"])
    wanted = np.stack([column(result, "mu_star"), column(result, "sigma")], axis=1)
    np.testing.assert_allclose(np.sort(points, axis=0), np.sort(wanted, axis=0))


def test_salib_is_loaded_for_analyses_only():
    import subprocess
    import sys

    code = (
        "import sys, multicell as mc, multicell.cli.main; mc.load_scene('settle'); mc.sensitivity; "
        "print(*(name in sys.modules for name in ('SALib', 'pandas', 'xarray', 'distributed')))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert set(done.stdout.split()) == {"False"}


@pytest.mark.slow
def test_numbers_are_those_of_this_analysis_with_and_without_a_page(tmp_path, here):
    out = tmp_path / "out"
    sizes = []
    for more in ((), ("--size", "8", "--no-report"), ("--size", "8", "--no-report")):
        done = command(tmp_path, "--observable", "diameter", *more)
        assert done.exit_code == 0, done.output
        document = json.loads((out / "sensitivity.json").read_text())
        rows = list(csv.DictReader(io.StringIO((out / "sensitivity.csv").read_text())))
        assert [float(row["mu"]) for row in rows] == [row["mu"] for row in document["table"]]
        sizes.append(document["size"])
        (out / "sensitivity.csv").write_text("damaged")
        (out / "sensitivity.json").write_text("damaged")
    assert sizes == [4, 8, 8]


@pytest.mark.slow
def test_numbers_are_there_before_a_page_that_cannot_be_written(tmp_path, here, monkeypatch):
    from multicell.calibration.sensitivity import page

    def full(*_):
        raise OutputError("cannot write: No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(page, "write_sensitivity_report", full)
        done = command(tmp_path, "--observable", "diameter")
    assert "No space left" in done.output
    assert json.loads((tmp_path / "out" / "sensitivity.json").read_text())["size"] == 4
    count = len(here)
    assert command(tmp_path, "--observable", "diameter").exit_code == 0
    assert len(here) == count
