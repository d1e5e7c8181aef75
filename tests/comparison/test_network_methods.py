"""Methods of networks compared on the steps of a run, and where they fail."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from alarcon import START, alarcon, alarcon_scene
from click.testing import CliRunner

import multicell as mc
from multicell.cli.main import main
from multicell.comparison.measured import LOG_FILE
from multicell.comparison.network_precision import compare_networks
from multicell.comparison.network_reference import cvode_end, largest_rates
from multicell.comparison.network_steps import record_network, solve_steps
from multicell.comparison.numbers import COMPARISON_FILES
from multicell.comparison.stability_limits.networks import network_stability
from multicell.comparison.stability_limits.trial import BLOW_UP
from multicell.errors import SceneError
from multicell.networks.custom import network
from multicell.networks.solver import NetworkFailed, NetworkSolver
from multicell.results.documents import Lines

STILL = {"duration": "1 h", "initial.count": 3, "growth": None, "output.every": "1 h"}


@network(states={"A": 1.0, "B": 0.5}, inputs={"drive": 0.0}, parameters={"k": 1e-3})
def driven(t, y, u, p, out):
    """A smooth network that is not stiff, driven by an input that rises."""
    out[0] = p[0] * (u[0] * 1e-3 - y[0] * y[1])
    out[1] = p[0] * (y[0] - y[1])


@network(states={"A": 1.0}, parameters={"k": 5.0})
def quick(t, y, u, p, out):
    """Decay at a rate that is known."""
    out[0] = -p[0] * y[0]


@network(states={"A": 1.0, "B": 0.0, "C": 0.0})
def robertson_cells(t, y, u, p, out):
    """Robertson's reactions."""
    out[0] = 1e4 * y[1] * y[2] - 0.04 * y[0]
    out[2] = 3e7 * y[1] * y[1]
    out[1] = -out[0] - out[2]


def _scene(own, **more):
    return mc.load_scene("growth").with_changes({**STILL, "networks": {"n": own}, **more})


SMOOTH = _scene({"network": driven, "inputs": {"drive": "time"}, "dilution": False})


@pytest.fixture(scope="module")
def compared(tmp_path_factory):
    folder = tmp_path_factory.mktemp("compared")
    found = compare_networks(SMOOTH, output=folder / "out", stepwise=3, repeats=1, threads=1,
                             ladder={"step": [300.0, 150.0, 75.0, 37.5]})  # fmt: skip
    return found, folder / "out"


@pytest.mark.parametrize(("method", "order"), [("euler", 1.0), ("rk4", 4.0)])
def test_fixed_steps_have_their_order(compared, method, order):
    assert compared[0].order(method, finest=3) == pytest.approx(order, abs=0.15)


def test_work_is_counted_as_it_is_done(compared):
    result, _ = compared
    cells = result.facts["cells"][1]
    for method, stages in (("euler", 1), ("rk4", 4)):
        for row in result.rows(method):
            steps = 3 * cells * round(600.0 / row["setting"])
            assert (row["steps"], row["evaluations"]) == (steps, stages * steps)
    for row in result.rows("dormand-prince"):
        tried = row["steps"] + row["rejections"]
        # the last stage of a step is the first of the next, but not of the next coupling step
        assert row["evaluations"] == 6 * tried + 3 * cells
    for row in result.rows("rodas3"):  # f, two states, time, and two more stages with rates
        assert row["evaluations"] >= 5 * row["steps"]


def test_error_falls_with_the_tolerance_and_the_files_are_there(compared):
    result, folder = compared
    for method in ("rodas3", "rodas4", "dormand-prince", "auto"):
        rows = {row["setting"]: row["error_worst_cell"] for row in result.rows(method)}
        assert len(rows) == 9
        assert rows[1e-9] < 1e-7 < rows[0.1]
    assert {file.name for file in folder.iterdir()} == {*COMPARISON_FILES} - {"conditioning.csv"}
    assert not (folder / LOG_FILE).exists()
    # by CPU time, which on a busy machine may favour either of two methods that are close
    assert re.fullmatch(
        r"At 0\.0001 %: \S+, (\S+ times|no) cheaper than \S+\.", result.verdict(1e-6)
    )
    assert mc.NetworkPrecision.read(folder / "workprecision.json").table == result.table
    assert "CVODE on one cell" in (folder / "report.html").read_text(encoding="utf-8")


def test_states_that_blow_up_are_failed_solves():
    result = compare_networks(
        _scene({"network": quick}), methods=["euler", "rodas3"], stepwise=1, repeats=1, threads=1,
        ladder={"step": [1.0, 0.01], "tolerance": [1e-3]},
    )  # fmt: skip
    failed, done = result.with_values(method="euler")
    assert failed["status"] == "failed"
    assert done["status"] == "done"
    assert result.rows("rodas3")[0]["error_worst_cell"] < 0.01


@pytest.mark.slow
def test_a_comparison_continues_with_the_methods_of_networks_that_are_left(tmp_path):
    file = tmp_path / "n.ant"
    file.write_text("A = 1; A' = -0.001*A;\n", encoding="utf-8")
    scene = _scene({"file": str(file)})
    asked = {"methods": ["rodas3", "rk4"], "output": tmp_path / "out", "stepwise": 2,
             "repeats": 1, "threads": 1,
             "ladder": {"step": [60.0], "tolerance": [1e-3]}}  # fmt: skip

    def ends(words):
        if words.startswith("rk4"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        compare_networks(scene, progress=ends, **asked)
    (known,) = Lines(tmp_path / "out" / LOG_FILE).entries[1:]
    words = []
    found = compare_networks(scene, progress=words.append, **asked)
    assert "rodas3: was measured before" in words
    (row,) = found.rows("rodas3")
    assert row["error_state"] == known["rows"][0]["error_state"]
    assert row["cpu"] > 0.0


@pytest.mark.parametrize("own", [{"network": robertson_cells, "dilution": False},
                                 {"network": quick}])  # fmt: skip
def test_cvode_on_one_cell_finds_the_same(own):
    problem = record_network(_scene(own), "n", 2, 1, lambda _: None)
    found, _ = solve_steps(problem, "auto", 1e-9)
    for step, end in zip(problem.steps, found.states, strict=True):
        exact = cvode_end(problem, step, 1)
        np.testing.assert_allclose(end[1], exact, rtol=1e-6, atol=1e-8 * problem.scale.max())


def test_cvode_finds_the_same_oxygen_cell_cycle():
    problem = record_network(alarcon_scene(duration="6 h"), "cycle", 3, 1, lambda _: None)
    assert max(largest_rates(problem)) > 0.1  # stiff: the cycle takes hours
    for method in ("auto", "rodas3"):
        found, _ = solve_steps(problem, method, 1e-8)
        for step, end in zip(problem.steps, found.states, strict=True):
            np.testing.assert_allclose(end[0], cvode_end(problem, step, 0), rtol=1e-6, atol=1e-9)


def test_the_limits_of_a_decay_are_those_of_theory(tmp_path):
    result = network_stability(_scene({"network": quick}), methods=["rk4", "euler", "rodas3"],
                               output=tmp_path / "out", threads=1)  # fmt: skip
    for method, times in (("euler", 2.0), ("rk4", 2.785)):
        limit = result.limit(method)
        assert limit["rate"] == pytest.approx(5.0, rel=1e-3)
        assert limit["limit"] == pytest.approx(times / 5.0, rel=0.04)
        assert limit["theory"] == pytest.approx(times / 5.0, rel=1e-3)
        for moment in result.facts["moments"]:
            assert moment[method] == pytest.approx(times / 5.0, rel=0.04)
    assert result.limit("rodas3")["beyond"] == math.inf
    assert (tmp_path / "out" / "moments.csv").is_file()


@pytest.mark.slow
def test_fixed_steps_fail_in_the_oxygen_cell_cycle():
    result = network_stability(alarcon_scene(duration="6 h"), methods=["rk4", "auto"], threads=1)
    limit = result.limit("rk4")
    assert limit["limit"] == pytest.approx(limit["theory"], rel=0.15)
    assert limit["limit"] < 2.0  # s, where the coupling step has 600
    assert BLOW_UP in limit["kinds"]
    assert result.limit("auto")["limit"] >= 1e-3
    steps = [moment["rk4"] for moment in result.facts["moments"]]
    assert max(steps) > 10.0 * min(steps)


def test_fixed_steps_of_a_fiftieth_of_a_minute_lose_the_oxygen_cell_cycle():
    # a normal cell at full oxygen goes through the switch where Cdh1 falls to nothing
    begin, u = NetworkSolver(alarcon).begin(1), np.ones((1, 1))
    sure = NetworkSolver(alarcon, method="rodas4", relative=1e-9)
    exact = sure.advance(begin, u, u, 0.0, 600.0).y[0]
    assert exact[list(START).index("Cdh1")] < 0.004
    with pytest.raises(NetworkFailed, match="no finite number"):
        NetworkSolver(alarcon, method="rk4", length=0.02).advance(begin, u, u, 0.0, 600.0)
    loose = NetworkSolver(alarcon).advance(begin, u, u, 0.0, 600.0).y[0]
    np.testing.assert_allclose(loose, exact, rtol=5e-3)


def test_what_cannot_be_compared_is_refused_with_a_hint():
    with pytest.raises(SceneError, match="are none in this scene"):
        compare_networks(mc.load_scene("growth"))
    with pytest.raises(SceneError, match="has no 'm'"):
        compare_networks(SMOOTH, "m")
    with pytest.raises(SceneError, match="Did you mean 'rodas4'"):
        compare_networks(SMOOTH, methods=["rodas44"])
    with pytest.raises(SceneError, match=r"ladder\.heun"):
        compare_networks(SMOOTH, ladder={"heun": [1.0]})
    two = SMOOTH.with_changes({"networks.other": {"network": quick}})
    with pytest.raises(SceneError, match="one must be named"):
        compare_networks(two)


@pytest.mark.slow
def test_both_commands_take_networks(tmp_path):
    file = tmp_path / "scene.toml"
    (tmp_path / "n.ant").write_text("A = 1; A' = -0.5*A;\n", encoding="utf-8")
    file.write_text(_scene({"file": str(tmp_path / "n.ant")}).to_toml(), encoding="utf-8")
    for command in ("compare", "stability"):
        out = tmp_path / command
        more = ["--methods", "rodas3,rk4", "--output", str(out), "--networks"]
        done = CliRunner().invoke(main, [command, str(file), *more])
        assert done.exit_code == 0, done.output
        assert (out / "report.html").is_file()
