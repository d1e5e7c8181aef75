"""Solvers of fields compared on the last coupling step of a run."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.integrate import solve_ivp

import multicell as mc
from multicell.cli.main import main
from multicell.comparison.field_precision import compare_fields
from multicell.comparison.field_steps import record_fields, solve_fields
from multicell.comparison.measured import LOG_FILE
from multicell.comparison.numbers import COMPARISON_FILES
from multicell.errors import SceneError
from multicell.results.documents import Lines

FEW = {
    "initial.count": 8,
    "duration": "10 s",
    "coupling_step": "5 s",
    "output.every": "5 s",
    "nutrients.oxygen.diffusion": "60 um^2/s",
    "nutrients.oxygen.spacing": "12 um",
    "nutrients.oxygen.regime": "transient",
}
SWITCHED = {"nutrients.oxygen.media": [["0 s", "0.2 mM"], ["6 s", "0.1 mM"]]}
ASKED = {"methods": ["euler", "runge-kutta", "multicell-march"], "repeats": 1, "threads": 1}


def few(**more):
    return mc.load_scene("spheroid").with_changes(FEW | more)


@pytest.fixture(scope="module")
def compared(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fields") / "out"
    return compare_fields(few(**SWITCHED), output=folder, **ASKED), folder


@pytest.fixture(scope="module")
def step():
    return record_fields(few(**SWITCHED), "oxygen", 1, lambda _: None)


def test_the_step_is_that_of_the_run(step):
    """A run that takes the same solver ends where the solver ends on the recorded step."""
    run = mc.run(few(**SWITCHED))
    assert (step.begin, step.end, step.steady) == (6.0, 10.0, False)
    tolerance = run.scene.nutrients["oxygen"].time_tolerance
    found = solve_fields(step, "multicell-march", "tolerance", tolerance)
    values = run.frames[-1].fields["oxygen"].values
    np.testing.assert_allclose(found.data[0], values, rtol=1e-9)
    plain, frames = record_fields(few(), "oxygen", 1, lambda _: None), mc.run(few()).frames
    np.testing.assert_allclose(plain.data[0], frames[-2].fields["oxygen"].values, rtol=1e-3)


def test_errors_are_distances_from_what_scipy_finds(step, compared):
    """DOP853 on the rates of the equation."""

    def slope(t, y):
        return step.equation.rates(y.reshape(step.data.shape), t)[0].ravel()

    start = step.data.ravel()
    c = solve_ivp(slope, (step.begin, step.end), start, "DOP853", rtol=1e-9, atol=1e-13).y[:, -1]
    c = c.reshape(step.data.shape)
    result, _ = compared
    for row in (result.rows("euler")[0], result.rows("multicell-march")[1]):
        found = solve_fields(step, row["method"], row["control"], row["setting"])
        error = np.abs(found.data - c).max() / step.scales[0]
        assert row["error_nodes"] == pytest.approx(error, rel=0.01)
    assert result.uncertainty["nodes"] < 1e-6


def test_fixed_steps_have_their_order(compared):
    result, _ = compared
    assert result.order("euler", finest=4) == pytest.approx(1.0, abs=0.15)
    rows = result.rows("multicell-march")
    assert rows[-1]["error_nodes"] < 1e-3 * rows[0]["error_nodes"]


def test_files_table_and_verdict(compared):
    result, folder = compared
    assert {file.name for file in folder.iterdir()} == {*COMPARISON_FILES} - {"conditioning.csv"}
    assert mc.FieldPrecision.read(folder / "workprecision.json").table == result.table
    assert re.match(r"At 1 %: \S+, (\S+ times|no) cheaper than \S+", result.verdict())
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "concentration at any node" in page
    assert "the last coupling step of oxygen" in page
    # the medium falls by half of the highest concentration
    assert 0.1 < result.facts["change"]["nodes"] < 0.6


def test_steady_fields_are_marched_for_longer_and_longer():
    result = compare_fields(
        few(**{"nutrients.oxygen.regime": "steady"}),
        methods=["multicell-steady", "multicell-march", "euler"], repeats=1, threads=1,
    )  # fmt: skip
    assert result.methods == ["multicell-steady", "euler"]
    (own,) = result.rows("multicell-steady")
    assert own["error_nodes"] < 1e-9
    marched = result.rows("euler")
    assert [row["control"] for row in marched] == ["time"] * len(marched)
    assert marched[-1]["error_nodes"] < 1e-9 < marched[0]["error_nodes"]
    words = (
        r"At 1 % no solve is needed: .* At 1e-\d+ %: multicell-steady, \S+ times cheaper than euler"
    )
    assert re.match(words, result.verdict())


def test_what_takes_too_long_is_not_tried_and_failures_have_words(step):
    result = compare_fields(
        few(), methods=["euler", "multicell-implicit"], patience=1e-6, repeats=1, threads=1
    )
    assert {row["status"] for row in result.with_values(method="euler")} == {"skipped"}
    assert len(result.rows("multicell-implicit")) == 7
    found = solve_fields(step, "euler", "step", 1e-6)
    assert "would need 4,000,000 steps of euler" in found.problem


def test_a_comparison_continues_with_the_solvers_that_are_left(tmp_path):
    asked = {**ASKED, "output": tmp_path / "out"}

    def ends(words):
        if words.startswith("runge-kutta"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        compare_fields(few(), progress=ends, **asked)
    (known,) = Lines(tmp_path / "out" / LOG_FILE).entries[1:]
    words = []
    found = compare_fields(few(), progress=words.append, **asked)
    assert "euler: was measured before" in words
    errors = [row["error_nodes"] for row in found.rows("euler")]
    assert errors == [row["error_nodes"] for row in known["rows"]]
    assert all(row["cpu"] > 0.0 for row in found.rows("euler"))


def test_refusals_and_the_command(tmp_path):
    for changes, words in (
        ({"field": "oxgen"}, "Did you mean 'oxygen'"),
        ({"methods": ["milstein"]}, "has no 'milstein'"),
        ({"clock": "sun"}, "must be"),
    ):
        with pytest.raises(SceneError, match=words):
            compare_fields(few(), **changes)
    with pytest.raises(SceneError, match="none in this scene"):
        compare_fields("settle")
    file = tmp_path / "few.toml"
    file.write_text(few().to_toml(), encoding="utf-8")
    out = str(tmp_path / "out")
    more = ["--methods", "multicell-march,euler", "--repeats", "1", "-o", out]
    done = CliRunner().invoke(main, ["compare", str(file), "--fields", "oxygen", *more])
    assert done.exit_code == 0, done.output
    assert "cheaper than" in done.output
    refused = CliRunner().invoke(main, ["compare", str(file), "--fields", "--networks", *more])
    assert refused.exit_code == 2
    assert not math.isnan(
        mc.FieldPrecision.read(tmp_path / "out/workprecision.json").table[0]["cpu"]
    )
