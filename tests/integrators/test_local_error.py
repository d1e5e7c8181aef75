"""The largest estimated error of a cell in one step, against errors that SciPy measures."""

import math

import numpy as np
import pytest
from oracles import reference, smooth_scene

import multicell as mc
from multicell.integrators.cvode import Cvode
from multicell.integrators.registry import make
from multicell.integrators.restarts import Run
from multicell.scene.parts import IntegratorOptions

ESTIMATING = [
    "cvode",
    "cvode-adams",
    "cvode-sparse",
    "ab2-adaptive",
    "dopri5",
    "rkc2",
    "auto",
    "rosenbrock",
]


@pytest.mark.parametrize("method", ESTIMATING)
def test_errors_of_all_steps_together_bound_the_error_at_the_end(method):
    """The scene contracts: what a step does wrong fades, so that errors at most add up."""
    position, system = smooth_scene()
    used = system()
    options = IntegratorOptions(method=method, rtol=1e-12, atol=1e-5)
    outcome = make(options).integrate(used, position)
    away = np.linalg.norm(outcome.position - reference(system(), position), axis=1).max()
    assert outcome.done
    assert away <= used.work.steps * outcome.local_error
    # per step no more than a thousand times what the tolerance lets a coordinate have
    assert outcome.local_error <= 1e-5 * math.sqrt(3 * 20)


@pytest.mark.parametrize("light", [True, False])
@pytest.mark.parametrize("atol", [1e-5, 1e-7])
def test_cvode_steps_have_the_errors_that_are_told(light, atol, monkeypatch):
    position, system = smooth_scene()
    taken = []
    step = Run._step

    def noted(run, solver):
        before, known = (run.elapsed, run.position.copy()), run.local_error
        run.local_error = math.nan
        length = step(run, solver)
        taken.append((*before, run.elapsed, run.position.copy(), run.local_error))
        run.local_error = float(np.fmax(known, run.local_error))
        return length

    with monkeypatch.context() as patch:
        patch.setattr(Run, "_step", noted)
        outcome = Cvode(1e-12, atol, light=light).integrate(system(), position)
    told = np.array([entry[4] for entry in taken])
    assert outcome.local_error == told.max()
    true = []
    for begin, start, end, stop, _ in taken:
        part = system()
        part.motion.begin, part.motion.end = begin, end
        true.append(np.linalg.norm(stop - reference(part, start), axis=1).max())
    assert 0.5 < told.max() / max(true) < 3.0


@pytest.mark.parametrize("method", ["euler-adaptive", "dopri5", "rkc2"])
def test_the_errors_of_a_few_steps(method):
    """Of a pair of formulas the worse one's error is told, and the better one's is made."""
    position, system = smooth_scene()
    used = system()
    used.motion.end = {"euler-adaptive": 0.02, "dopri5": 2.0, "rkc2": 0.2}[method]
    outcome = make(IntegratorOptions(method=method, rtol=1e-3, atol=10.0)).integrate(used, position)
    exact = reference(used, position)
    assert used.work.steps <= 5
    away = np.linalg.norm(outcome.position - exact, axis=1).max()
    assert 0.3 * away / used.work.steps < outcome.local_error < 100.0 * away


@pytest.mark.parametrize("method", ["euler", "heun", "ab2", "rk4", "backward-euler", "scipy-rk45"])
def test_a_method_without_an_estimate_tells_none(method):
    scene = mc.load_scene("settle").with_changes(
        {"initial.count": 20, "duration": "20 min", "integrator": method}
    )
    result = mc.run(scene)
    assert "largest_local_error" not in result.summary()["integrator"]


def test_the_summary_tells_the_largest_of_the_whole_run_also_after_a_resume(tmp_path):
    scene = mc.load_scene("growth").with_changes(
        {"duration": "8 h", "initial.count": 12, "initial.stage": "uniform", "output.every": "2 h"}
    )
    whole = mc.run(scene, output=tmp_path / "whole", report=False).summary()["integrator"]
    assert whole["largest_local_error"] > 0.0
    resumed = mc.resume(tmp_path / "whole", 1, output=tmp_path / "again", report=False)
    assert resumed.summary()["integrator"] == whole
    simulation = mc.Simulation(scene)
    seen = []
    while not simulation.finished:
        simulation.step()
        seen.append(simulation.local_error)
    assert seen[-1] == whole["largest_local_error"] == max(seen)
    assert seen == sorted(seen)
