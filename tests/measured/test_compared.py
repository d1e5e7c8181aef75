"""A run beside measured data: residuals follow from what was put in."""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner

import multicell as mc
from multicell.cli.main import main
from multicell.errors import DataError
from multicell.measured.compared import MeasuredComparison

SHORT = {"duration": "12 h", "initial.count": 4, "coupling_step": "1 h"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("compared")
    scene = mc.load_scene("growth").with_changes(SHORT)
    mc.run(scene, output=place / "run", report=False)
    made = mc.study(scene, vary={"cells.young": "1, 4 kPa"}, seeds=2, output=place / "study")
    made.run(cores=1)
    return place


@pytest.fixture(scope="module")
def run(folder):
    return mc.load_result(folder / "run")


def table_of(run, shift, hours=(3.0, 6.0, 7.5)):
    """Return data that lie off the run by ``shift`` times their errors."""
    time = run.history["time"] / 3600.0
    diameter = np.interp(hours, time, run.history["diameter"])
    cells = np.interp(hours, time, run.history["cells"])
    return {
        "Time (h)": list(hours),
        "Diameter (µm)": (diameter - 0.5 * np.array(shift)).tolist(),
        "SD": [0.5] * len(hours),
        "cells": (cells * np.exp(-0.1 * np.array(shift))).tolist(),
        "cells sd / %": [10.0] * len(hours),
    }


def test_residuals_are_distances_over_errors(run):
    shift = [1.0, -2.0, 0.25]
    found = run.compare_with(table_of(run, shift))
    by_name = {"diameter": [], "cells": []}
    for datum, residual in zip(found.data, found.residuals, strict=True):
        by_name[datum.observable].append(residual)
    assert by_name["diameter"] == pytest.approx(shift, abs=1e-9)
    assert by_name["cells"] == pytest.approx(shift, abs=1e-9)
    assert found.chi_squared == pytest.approx(2.0 * np.square(shift).sum())
    frame = found.to_pandas()
    assert list(frame["residual"]) == pytest.approx(found.residuals.tolist())
    assert len(found.plot().axes) == 2


def test_several_runs_add_their_scatter(run):
    found = run.compare_with({"time / h": [3.0], "diameter / um": [1.0], "sd": [2.0]})
    values = np.array([[10.0], [14.0], [12.0]])
    several = MeasuredComparison(found.data, values, found.histories, found.units, "")
    s2 = values.var(ddof=1)
    expected = (12.0 - 1.0) / np.sqrt(4.0 + s2 * (1.0 + 1.0 / 3.0))
    assert several.residuals == pytest.approx([expected])


def test_what_a_run_does_not_have_is_left_out_and_said(run):
    rows = {"time / h": [3.0, 40.0], "diameter / um": [20.0, 30.0]}
    found = run.compare_with(rows)
    assert len(found.data) == 1
    assert found.notes == (
        "1 data have nothing to compare with, the first one diameter in row 1",
        "data without an error have one of 10 %",
    )
    with pytest.raises(DataError, match="no run has a value at the times of the data"):
        run.compare_with({"time / h": [40.0], "diameter / um": [20.0]})
    other = {"time / h": [3.0, 3.0], "diameter / um": [20.0, 21.0], "cells.young / kPa": [9, 1]}
    with pytest.raises(DataError, match=r"under other conditions.*young 9 kPa"):
        run.compare_with({title: column[:1] for title, column in other.items()})
    assert "1 data of other conditions are left out" in run.compare_with(other).notes


@pytest.mark.slow
def test_the_report_holds_the_comparison(run, tmp_path):
    found = run.compare_with(table_of(run, [1.0, 0.0, 0.0]))
    text = run.report(tmp_path, comparison=found).read_text(encoding="utf-8")
    assert "Compared with measured data" in text
    assert "χ² = 2 for 6 data" in text
    assert "+1.00" in text
    assert (tmp_path / "measured.png").stat().st_size > 10_000
    assert "Compared with" not in run.report(tmp_path).read_text(encoding="utf-8")


def test_a_study_is_sorted_by_what_is_nearest(folder, run):
    made = mc.load_study(folder / "study")
    points = made.compare_with(table_of(run, [0.0, 0.0, 0.0]))
    assert len(points) == 2
    assert {len(point.comparison.runs) for point in points} == {2}
    each = [point.comparison.chi_squared for point in points]
    assert each == sorted(each)
    stiff = table_of(run, [0.0, 0.0, 0.0]) | {"cells.young / kPa": [4.0] * 3}
    (one,) = made.compare_with(stiff)
    assert one.coordinates == {"young": 4.0}


def invoke(*arguments):
    done = CliRunner().invoke(main, list(map(str, arguments)))
    assert done.exit_code == 0, done.output
    return done


@pytest.mark.slow
def test_commands_draw_data_over_runs_and_studies(folder, run, tmp_path):
    rows = table_of(run, [1.0, 0.0, 0.0])
    data = tmp_path / "mine.csv"
    data.write_text(
        "Hour;D\n" + "\n".join(f"{t};{d}".replace(".", ",") for t, d in
                               zip(rows["Time (h)"], rows["Diameter (µm)"], strict=True))
    )  # fmt: skip
    names = ("--data", data, "--columns", "hour=Hour, diameter=D um", "--where", "Hour=0..7")
    picture = tmp_path / "a.png"
    done = invoke("plot", folder / "run", *names, "-o", picture)
    assert picture.stat().st_size > 10_000
    assert "for 2 data" in done.output
    invoke("view", folder / "run", *names, "--no-browser")
    assert "for 2 data" in (folder / "run" / "report.html").read_text(encoding="utf-8")
    done = invoke("study", "report", folder / "study", *names, "--json")
    assert len(json.loads(done.stdout)["points"]) == 2
    text = (folder / "study" / "report.html").read_text(encoding="utf-8")
    assert "at the nearest point" in text
    done = CliRunner().invoke(main, ["plot", str(folder / "run"), "--where", "a=1", "-o", "b.png"])
    assert done.exit_code == 2
    assert "belong to --data" in done.output


def test_rows_of_the_command_are_single_specimens_where_it_says_so(folder, run, tmp_path):
    """Their scatter is the error then, not the 10 % of data that come without one."""
    data, said = tmp_path / "pairs.csv", []
    data.write_text("Hour,Diameter (um)\n4,11\n4,12\n6,12\n6,14\n")
    for kind in ("same", "single"):
        names = ("--data", data, "--columns", 'hour=Hour, diameter="Diameter (um)"')
        picture = tmp_path / f"{kind}.png"
        said.append(invoke("plot", folder / "run", *names, "--specimens", kind, "-o", picture))
    assert ["have one of 10 %" in done.output for done in said] == [True, False]
