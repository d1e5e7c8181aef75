"""Dose response: known curves, coverage of intervals, closed forms of combinations, the command."""

import csv
import json
import math

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.optimize import curve_fit

import multicell as mc
from multicell.calibration.dose_response import analysis as room
from multicell.calibration.dose_response.analysis import plan_dose_response
from multicell.calibration.dose_response.curve import dose_at, draw_means, fit_curve, hill
from multicell.cli.main import main
from multicell.errors import DataError, ExitCode, FitFailed, SceneError
from multicell.studies.engine import RunOutcome

DOSES = np.concatenate([[0.0], np.geomspace(0.03, 30.0, 8)])
KNOWN = np.array([0.1, 0.0, 1.5])  # bottom, log EC50, h
DRUG = "nutrients.drug.boundary"
FIELD = {"boundary": 0, "diffusion": "500 um^2/s", "uptake": 0, "growth_inhibition": "1 uM"}
COLONY = mc.Scene.from_dict(
    {"title": "A colony", "duration": "24 h", "coupling_step": "1 h", "seed": 3,
     "initial": {"count": 8, "stage": "asynchronous"}, "growth": {"cycle_time": "12 h"},
     "nutrients": {"drug": FIELD, "other": FIELD}, "output": {"every": "24 h"}}
)  # fmt: skip


def curve(values, doses=DOSES, *, shared=True, seed=0, resamples=100):
    counts = np.isfinite(values).sum(axis=1).astype(float)
    draws = draw_means(values, shared, resamples, seed)
    return fit_curve(doses, values.mean(axis=1), counts, draws, name="drug", unit="uM",
                     resamples=resamples, seed=seed)  # fmt: skip


@pytest.mark.parametrize("slope", [0.7, 1.5, 6.0])
def test_a_curve_without_noise_is_found(slope):
    known = np.array([0.2, math.log(0.8), slope])
    found = curve(250.0 * hill(DOSES, known)[:, None].repeat(2, axis=1))
    assert found.ec50.value == pytest.approx(0.8, rel=1e-5)
    assert found.slope.value == pytest.approx(slope, rel=1e-5)
    assert found.bottom.value == pytest.approx(0.2, abs=1e-5)
    # 0.2 + 0.8 / (1 + u^h) = 1/2
    assert found.ic50.value == pytest.approx(0.8 * (5.0 / 3.0) ** (1.0 / slope), rel=1e-5)
    assert found.ic50.low == pytest.approx(found.ic50.value, rel=1e-4)


def test_the_fit_is_that_of_scipys_curve_fit():
    rng = np.random.default_rng(5)
    counts = rng.integers(1, 6, len(DOSES)).astype(float)
    means = 100.0 * hill(DOSES, KNOWN) * (1.0 + 0.05 * rng.standard_normal(len(DOSES)))
    found = fit_curve(DOSES, means, counts, None, name="", unit="", resamples=100, seed=0)

    def model(d, bottom, ec50, h):
        return bottom + (1.0 - bottom) / (1.0 + (d / ec50) ** h)

    wanted, _ = curve_fit(model, DOSES, means / means[0], [0.1, 1.0, 1.0],
                          sigma=1.0 / np.sqrt(counts))  # fmt: skip
    got = [found.bottom.value, found.ec50.value, found.slope.value]
    assert got == pytest.approx(wanted, rel=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("shared", [True, False])
def test_intervals_cover_what_is_true(shared):
    """95 % of 200 within three binomial standard deviations; seeds scatter all doses alike."""
    rng, repeats = np.random.default_rng(11), 200
    true = {"ic50": float(dose_at(0.5, KNOWN)), "slope": 1.5}
    covered = dict.fromkeys(true, 0)
    for repeat in range(repeats):
        noise = 0.05 * rng.standard_normal((len(DOSES), 5))
        values = hill(DOSES, KNOWN)[:, None] + noise
        if shared:
            values = values * (1.0 + 0.2 * rng.standard_normal(5))
        found = curve(80.0 * values, shared=shared, seed=repeat, resamples=60)
        for name, value in true.items():
            estimate = getattr(found, name)
            covered[name] += estimate.low <= value <= estimate.high
    for name, count in covered.items():
        assert abs(count / repeats - 0.95) < 3.0 * math.sqrt(0.95 * 0.05 / repeats), name


def test_what_seeds_share_is_no_noise():
    """Populations of other sizes respond alike: relative to their controls nothing scatters."""
    values = hill(DOSES, KNOWN)[:, None] * np.array([50.0, 80.0, 100.0, 140.0])
    together, apart = curve(values), curve(values, shared=False)
    assert together.ic50.high / together.ic50.low < 1.0001
    assert apart.ic50.high / apart.ic50.low > 1.5


def test_a_bottom_at_zero_leaves_intervals_their_width():
    """Each resampled fit is as good as SciPy's with bounds, where the best bottom is zero."""
    doses = np.array([0.0, 0.25, 0.5, 1.0, 2.0, 4.0])
    values = hill(doses, np.array([-0.04, 0.0, 2.0]))[:, None]
    values = values * np.random.default_rng(2).normal(1.0, 0.05, (6, 3))
    found = curve(values, doses, resamples=40)
    assert found.bottom.value == pytest.approx(0.0, abs=1e-6)

    def model(d, bottom, place, slope):
        return hill(d, np.array([bottom, place, slope]))

    draws = draw_means(values, True, 40, 0)
    for drawn, got in zip(draws / draws[:, :1], found.draws, strict=True):
        best, _ = curve_fit(model, doses, drawn, [0.05, 0.0, 2.0],
                            bounds=([0.0, -9.0, 0.1], [2.0, 9.0, 20.0]))  # fmt: skip
        costs = [((model(doses, *p) - drawn) ** 2).sum() for p in (got, best)]
        assert costs[0] < costs[1] + 1e-5
    assert found.ic50.high / found.ic50.low > 1.02


def test_half_beyond_the_doses_is_not_told():
    weak = curve(hill(DOSES, np.array([0.0, math.log(200.0), 2.0]))[:, None].repeat(3, 1))
    assert math.isnan(weak.ic50.value)
    assert weak.ic50.high == math.inf
    assert weak.ic50.words.startswith("not reached: above 30 uM")
    strong = curve(hill(DOSES, np.array([0.0, math.log(1e-3), 2.0]))[:, None].repeat(3, 1))
    assert strong.ic50.words.startswith("not reached: below 0.03 uM")
    partial = curve(hill(DOSES, np.array([0.6, 0.0, 2.0]))[:, None].repeat(3, 1))
    assert math.isnan(partial.ic50.value)
    assert partial.ec50.value == pytest.approx(1.0, rel=1e-4)


def test_one_response_at_each_dose_has_intervals_from_the_curve():
    rng = np.random.default_rng(3)
    values = hill(DOSES, KNOWN) + 0.03 * rng.standard_normal(len(DOSES))
    found = mc.dose_response(data={"dose [uM]": DOSES, "response": values})
    assert any("no replicates" in note for note in found.notes)
    assert found.ic50.low < float(dose_at(0.5, KNOWN)) < found.ic50.high


def grid(combined, noise=0.0, replicates=3, seed=8):
    """Return a table of two drugs whose viability is a function of both doses."""
    side = np.concatenate([[0.0], np.geomspace(0.1, 10.0, 5)])
    a, b = (x.ravel().repeat(replicates) for x in np.meshgrid(side, side, indexing="ij"))
    rng = np.random.default_rng(seed)
    values = 400.0 * combined(a, b) * (1.0 + noise * rng.standard_normal(len(a)))
    which = np.tile(np.arange(replicates), len(side) ** 2)
    return {"dose A / uM": a, "dose B / nM": b, "response": values, "replicate": which}


ONE, OTHER = np.array([0.0, 0.0, 1.2]), np.array([0.15, math.log(0.5), 2.0])


def test_independent_drugs_have_no_bliss_excess():
    found = mc.dose_response(data=grid(lambda a, b: hill(a, ONE) * hill(b, OTHER)))
    assert len(found.combination) == 25
    excess = [row["bliss_excess"] for row in found.combination]
    assert excess == pytest.approx([0.0] * 25, abs=1e-12)


@pytest.mark.slow
def test_intervals_of_independent_drugs_cover_no_excess(monkeypatch):
    monkeypatch.setattr(room, "RESAMPLES", 100)
    inside = []
    for seed in range(20):
        table = grid(lambda a, b: hill(a, ONE) * hill(b, OTHER), 0.05, 4, seed)
        found = mc.dose_response(data=table)
        inside.append(found.totals["bliss_excess"].low < 0.0 < found.totals["bliss_excess"].high)
    assert sum(inside) >= 16  # of 20 at 95 %, fewer in one of 4,000


def test_a_drug_with_itself_has_loewe_index_one():
    found = mc.dose_response(data=grid(lambda a, b: hill(a + b, ONE)))
    index = [row["loewe_index"] for row in found.combination]
    assert index == pytest.approx([1.0] * 25, rel=1e-4)
    # together they leave fewer alive than the largest dose alone: the curve is continued there
    beyond = [row["extrapolated"] for row in found.combination]
    assert beyond == [row["dose A"] + row["dose B"] > 10.0 for row in found.combination]
    assert found.totals["loewe_index"].value == pytest.approx(1.0, rel=1e-4)


def test_synergy_lies_below_one_and_what_one_drug_never_does_has_no_index():
    found = mc.dose_response(data=grid(lambda a, b: hill(a + b + 5.0 * a * b, ONE), 0.02))
    total = found.totals["loewe_index"]
    assert total.high < 1.0
    assert found.totals["bliss_excess"].low > 0.0
    partial = mc.dose_response(data=grid(lambda a, b: hill(a, ONE) * hill(b, OTHER)))
    low = [row for row in partial.combination if row["viability"] < 0.15]
    assert low
    assert all(math.isnan(row["loewe_index"]) and not row["extrapolated"] for row in low)


def test_the_table_that_is_written_is_read_as_data(tmp_path):
    rng = np.random.default_rng(1)
    values = hill(DOSES, KNOWN)[:, None] + 0.04 * rng.standard_normal((len(DOSES), 3))
    table = {"dose / uM": DOSES.repeat(3), "response": values.ravel(),
             "replicate": np.tile([1, 2, 3], len(DOSES))}  # fmt: skip
    first = mc.dose_response(data=table, output=tmp_path, report=False)
    (tmp_path / "again.csv").write_text(first.to_csv())
    again = mc.dose_response(data=tmp_path / "again.csv")
    assert again.ic50 == first.ic50
    assert again.curve.unit == "uM"


PAIR = {"dose": list(DOSES) * 2, "response": [*(1.0 - DOSES / 40.0)] * 2}
TABLES = {
    "unknown title": ({"dosis": DOSES, "response": DOSES}, "Did you mean 'dose'"),
    "no response": ({"dose": DOSES}, "no column 'response'"),
    "two of a name": (
        {"dose": DOSES, "Dose": DOSES, "response": DOSES}, "has the name of another column, too"
    ),
    "no control": ({"dose": DOSES[1:], "response": DOSES[1:]}, "dose 0, the control"),
    "too few": ({"dose": DOSES[:4], "response": DOSES[:4]}, "3 doses above 0 in 'dose'"),
    "negative": ({"dose": [-1.0, *DOSES], "response": [1.0, *DOSES]}, "a dose below 0"),
    "twice": ({**PAIR, "replicate": ["a"] * 18}, "second one of the replicate 'a'"),
    "no single": (
        {"dose A": [*DOSES, *(0 * DOSES[1:]), 7.0], "dose B": [*(0 * DOSES), *DOSES[1:], 1.0],
         "response": [1.0] * 18}, "no response at"),
}  # fmt: skip


@pytest.mark.parametrize("case", TABLES)
def test_a_table_that_cannot_be_used_is_refused(case):
    table, words = TABLES[case]
    with pytest.raises(DataError, match=words):
        mc.dose_response(data=table)


def test_responses_without_a_curve_are_refused():
    with pytest.raises(FitFailed, match="is 3 at all doses"):
        mc.dose_response(data={"dose": DOSES, "response": 0.0 * DOSES + 3.0})
    with pytest.raises(FitFailed, match="the control has the response 0"):
        mc.dose_response(data={"dose": DOSES, "response": DOSES})


RISING = "0, log 0.1:10:4 uM"
ASKED = {
    "no control": ({"doses": "log 0.1:10:5 uM"}, "no dose 0, the control"),
    "too few": ({"doses": "0,1,2,3 uM"}, "3 doses above the control"),
    "not rising": ({"doses": "0,1,3,2,4 uM"}, "do not rise"),
    "one key": ({"dose": None, "combine": (DRUG,)}, "must be two keys"),
    "no schedule": ({"dose": "nutrients.drug.media"}, "no concentration above 0"),
    "data too": ({"data": PAIR}, "stands in place of a scene"),
}


@pytest.mark.parametrize("case", ASKED)
def test_what_cannot_be_asked_is_refused_before_anything_runs(case, tmp_path):
    changed, words = ASKED[case]
    given = {"dose": DRUG, "doses": RISING, "output": tmp_path / "out"} | changed
    with pytest.raises(SceneError, match=words):
        mc.dose_response(COLONY, **given)
    assert not (tmp_path / "out").exists()


def test_doses_are_points_of_a_study():
    plan = plan_dose_response(COLONY, DRUG, RISING, seeds=2)
    assert plan.units == ("uM",)
    assert plan.points[:, 0] == pytest.approx([0.0, *np.geomspace(0.1, 10.0, 4)])
    levels = [scene.nutrients["drug"].boundary for scene in plan.study.scenes]
    assert levels == pytest.approx(1e-3 * plan.points[:, 0])
    two = plan_dose_response(
        COLONY, None, (RISING, "0, 1:5:5 nM"), combine=(DRUG, "nutrients.other.boundary")
    )
    assert two.points.shape == (30, 2)
    assert two.units == ("uM", "nM")


def test_the_dose_of_a_schedule_takes_the_place_of_each_concentration_above_zero():
    scene = COLONY.with_changes({"nutrients.drug.media": [["1 h", 0.5], ["2 h", 0], ["3 h", 1]]})
    plan = plan_dose_response(scene, "nutrients.drug.media", RISING)
    assert plan.study.scenes[-1].nutrients["drug"].media == (
        (3600.0, 0.01), (7200.0, 0.0), (10800.0, 0.01),
    )  # fmt: skip
    assert all(level == 0.0 for _, level in plan.study.scenes[0].nutrients["drug"].media)


@pytest.mark.slow
def test_a_study_through_the_command(tmp_path, here):
    """Growth at the rate of cycles over 1 + c/K: half of four times is left where c = K, 1 uM."""
    (tmp_path / "colony.toml").write_text(COLONY.to_toml())
    out = tmp_path / "out"
    asked = ["dose-response", str(tmp_path / "colony.toml"), "--dose", f"{DRUG}=0, log 0.1:10:4 uM",
             "--seeds", "2", "-o", str(out), "--cores", "1"]  # fmt: skip
    done = CliRunner().invoke(main, [*asked, "--json"])
    assert done.exit_code == 0, done.output
    document = json.loads(done.stdout)
    assert document["curves"][0]["IC50"]["value"] == pytest.approx(1.0, rel=0.35)
    assert len(here) == len(document["table"]) == 10
    names = {path.name for path in out.iterdir()}
    assert {"report.html", "dose_response.csv", "dose_response.json", "dose_response.png",
            "dose_response.svg", "study.toml"} <= names  # fmt: skip
    rows = list(csv.DictReader((out / "dose_response.csv").open()))
    first = [float(row["response"]) for row in rows if row["dose / uM"] == "0.0"]
    assert [float(row["viability"]) for row in rows[:2]] == pytest.approx(
        [value / np.mean(first) for value in first]
    )
    html = (out / "report.html").read_text("utf-8")
    assert "IC50" in html
    assert "drug boundary" in html
    study = mc.load_study(out)
    assert {state.state for state in study.status()} == {"done"}
    # nothing is computed twice, and the tables are written without a page too
    for name in ("report.html", "dose_response.csv", "dose_response.json"):
        (out / name).unlink()
    words = CliRunner().invoke(main, [*asked, "--no-report"]).output
    assert [(out / f"dose_response.{end}").exists() for end in ("csv", "json")] == [True, True]
    assert not (out / "report.html").exists()
    assert "living cells over drug boundary (uM)" in words
    assert len(here) == 10


def test_a_run_that_fails_is_told_and_left_out(tmp_path, monkeypatch):
    """In place of runs their outcomes and final values: one run of one dose fails."""
    from multicell.studies.study import Study

    plan = plan_dose_response(COLONY, DRUG, RISING, seeds=3)
    values = (100.0 * hill(1e3 * plan.points[:, 0], KNOWN)[:, None] + [-2.0, 0.0, 2.0]).ravel()
    lost = plan.study.names[7]
    values[7] = math.nan
    monkeypatch.setattr(Study, "run", lambda *_, **__: [])
    final = {"proliferating": values, "quiescent": 0.0 * values}
    monkeypatch.setattr(room, "read_final", lambda *_: (final, {lost: "step failed: no way"}))
    found = mc.dose_response(COLONY, DRUG, RISING, seeds=3, output=tmp_path, report=False)
    assert found.notes == ["1 runs failed and are left out, the first one: step failed: no way"]
    (row,) = (row for row in found.table if row["reason"])
    assert row["run"] == lost
    assert math.isnan(row["viability"])
    assert len(found.table) == 15
    assert "NaN" not in found.to_json()
    (tmp_path / "again.csv").write_text(found.to_csv())
    again = mc.dose_response(data=tmp_path / "again.csv")
    assert again.curve.viability == pytest.approx(found.curve.viability)


@pytest.mark.parametrize(
    ("kind", "code"), [("machine", ExitCode.MACHINE), ("run", ExitCode.FAILED)]
)
@pytest.mark.parametrize("quiet", [[], ["--quiet"]])
@pytest.mark.parametrize("lost", [1, 8])
def test_runs_that_the_machine_has_stopped_are_its_failure(
    lost, kind, code, quiet, tmp_path, monkeypatch
):
    """Also where too few are left for a curve, of which the runs themselves say nothing."""
    from multicell.studies.study import Study

    plan = plan_dose_response(COLONY, DRUG, RISING, seeds=2)
    values = (100.0 * hill(1e3 * plan.points[:, 0], KNOWN)[:, None] + [-1.0, 1.0]).ravel()
    values[-lost:] = math.nan
    reason = "cannot write: No space left on device" if kind == "machine" else "step failed"
    outcomes = [RunOutcome(name, "failed", reason, kind=kind) for name in plan.study.names[-lost:]]

    def run(*_, progress, **__):
        for outcome in outcomes:
            progress(outcome)
        return outcomes

    final = {"proliferating": values, "quiescent": 0.0 * values}
    monkeypatch.setattr(Study, "run", run)
    known = {outcome.name: reason for outcome in outcomes}
    monkeypatch.setattr(room, "read_final", lambda *_: (final, known))
    (tmp_path / "colony.toml").write_text(COLONY.to_toml())
    done = CliRunner().invoke(main, ["dose-response", str(tmp_path / "colony.toml"), "--dose",
                                     f"{DRUG}={RISING}", "--seeds", "2", "--cores", "1",
                                     "-o", str(tmp_path / "out"),
                                     "--no-report", *quiet])  # fmt: skip
    assert done.exit_code == code, done.output
    said = [line for line in done.output.splitlines() if line.startswith("Error: ")]
    assert len(said) == (kind == "machine" or lost == 8)
    if kind == "machine":
        assert said[0].endswith(reason)


@pytest.mark.slow
def test_the_command_of_measured_data(tmp_path):
    table = mc.dose_response(data=grid(lambda a, b: hill(a + b, ONE), 0.02))
    (tmp_path / "data.csv").write_text(table.to_csv())
    out = tmp_path / "out"
    done = CliRunner().invoke(
        main, ["dose-response", "--data", str(tmp_path / "data.csv"), "-o", str(out)]
    )
    assert done.exit_code == 0, done.output
    assert "mean Loewe index" in done.output
    html = (out / "report.html").read_text("utf-8")
    assert "Loewe index" in html
    assert "as a scene file" not in html
    assert len(list(csv.reader((out / "combination.csv").open()))) == 26


@pytest.mark.parametrize(
    ("given", "words"),
    [(["growth", "--data", "x.csv"], "Give a SCENE"), (["growth"], "given 0 times"),
     (["--data", "x.csv"], "does not exist"), (["--data", "x.csv", "--set", "a=1"], "belong to")],
)  # fmt: skip
def test_the_command_says_what_is_wrong(given, words, tmp_path):
    done = CliRunner().invoke(main, ["dose-response", *given, "-o", str(tmp_path / "out")])
    assert done.exit_code == 2
    assert words in " ".join(done.output.split())


def test_the_picture_shows_each_response_the_control_and_half():
    values = hill(DOSES, KNOWN)[:, None] * np.array([0.95, 1.0, 1.05])
    table = {"dose / uM": DOSES.repeat(3), "response": values.ravel()}
    found = mc.dose_response(data=table)
    (axes,) = found.plot().axes
    points = {line.get_marker(): line.get_xydata() for line in axes.lines
              if line.get_marker() != "None"}  # fmt: skip
    assert points["D"][0] == pytest.approx([found.ic50.value, 0.5])
    dots = next(line for line in axes.lines if len(line.get_xdata()) == 27)
    assert np.sort(dots.get_ydata()) == pytest.approx(np.sort(values.ravel()))
    assert (dots.get_xdata()[:3] < DOSES[1]).all()
    assert axes.get_xticklabels()[0].get_text() == "control"
    assert axes.get_xlabel() == "dose (µM)"
