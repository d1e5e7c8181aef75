"""Predicted cost of transient fields, compared with the true one."""

import pytest

import multicell as mc
from multicell.nutrient.equations.solvers import MarchFieldSolver
from multicell.report.explain import cost
from multicell.simulation import Simulation


def secreting(**changes):
    """Return a scene whose field is all but linear: cells take up some, so that it needs steps."""
    field = {"regime": "transient", "boundary": 0, "uptake": 1e-9, "secretion": "0.01 amol/s",
             "diffusion": "10 um^2/s", "spacing": "10 um"}  # fmt: skip
    scene = mc.Scene.from_dict(
        {"duration": "90 min", "coupling_step": "10 min", "growth": {"cycle_time": "15 h"},
         "initial": {"count": 360, "stage": "asynchronous"}, "nutrients": {"signal": field}}
    )  # fmt: skip
    return scene.with_changes(changes)


@pytest.mark.sample(
    "{}",
    "{'nutrients.signal.diffusion': '100 um^2/s'}",
    "{'nutrients.signal.time_tolerance': 0.01}",
    "{'initial.stage': 'birth'}",
    "{'coupling_step': '2 min', 'duration': '40 min'}",
)
@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"nutrients.signal.diffusion": "100 um^2/s"},
        {"nutrients.signal.diffusion": "1000 um^2/s"},
        {"nutrients.signal.time_tolerance": 1e-2},
        {"nutrients.signal.time_tolerance": 1e-4},
        {"initial.stage": "birth"},
        {"initial.count": 60},
        {"initial.count": 1500, "nutrients.signal.diffusion": "100 um^2/s"},
        {"coupling_step": "2 min", "duration": "40 min"},
    ],
    ids=str,
)
def test_solutions_of_a_transient_field_within_a_factor_of_two(changes, monkeypatch):
    scene, made = secreting(**changes), []
    march = MarchFieldSolver._march

    def counting(self, pde, c, begin, end):
        before = self.info["steps"] + self.info["rejections"]
        found = march(self, pde, c, begin, end)
        made.append(self.info["steps"] + self.info["rejections"] - before)
        return found

    monkeypatch.setattr(MarchFieldSolver, "_march", counting)
    simulation = Simulation(scene, threads=1)
    steps = scene.duration / scene.coupling_step
    while simulation.time < scene.duration:
        simulation.step()
    expected = cost.solutions(scene, "signal", cost.predict(scene).course, steps)
    assert 0.5 < expected / (3.0 * sum(made)) < 2.0


def test_a_transient_field_costs_what_its_solutions_do():
    """Formerly it was expected to take as long as one that is solved once in a step."""
    scene = secreting()
    steady = scene.with_changes({"nutrients.signal.regime": "steady"})
    more = cost.predict(scene).seconds - cost.predict(steady).seconds
    made = cost.solutions(scene, "signal", cost.predict(scene).course, 9.0)
    nodes = float(cost._nodes(scene, "signal", cost.predict(scene).course.radius).min())
    assert more > 1e-7 * nodes * (made - 2.0 * 9.0)


def test_a_linear_field_is_expected_to_cost_no_steps(monkeypatch):
    scene = secreting()
    linear = scene.with_changes({"nutrients.signal.uptake": 0})
    steps, exact = cost.predict(scene).seconds, cost.predict(linear).seconds
    bare = cost.predict(scene.with_changes({"nutrients": {}})).seconds
    assert exact - bare < 0.2 * (steps - bare)
    monkeypatch.setattr(MarchFieldSolver, "_march", None)  # not called
    Simulation(linear, threads=1).step()
