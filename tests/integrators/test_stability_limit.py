"""Fixed steps of explicit methods beyond their limit of stability, in runs and out of them."""

import json
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest
from formulas import dense_jacobian
from strategies import cluster, mechanics

import multicell as mc
from multicell.errors import StepFailed
from multicell.integrators import stability
from multicell.integrators.base import MethodInfo
from multicell.integrators.registry import METHODS, from_options
from multicell.integrators.rkc import Rkc2
from multicell.integrators.runge_kutta import Euler
from multicell.integrators.shift import SHARE
from multicell.integrators.stability import glance, limit_of
from multicell.mechanics.decay_rate import largest_decay_rate
from multicell.scene.parts import IntegratorOptions
from multicell.simulation import Simulation

EXPLICIT = {"euler": 2.0, "heun": 2.0, "rk4": 2.785, "ab2": 1.0}


def scene_of(method, step, **changes):
    """Return growing cells whose largest decay rate is from 0.43 to 0.48/s after a step."""
    usual = {"duration": "2 h", "initial.count": 200, "initial.stage": "uniform"}
    scene = mc.load_scene("growth").with_changes(usual | {"drag.viscosity": 0.3} | changes)
    return scene.with_changes({"integrator": {"method": method, "step": step}})


def dense_rate(system, position, dimensions=3, whole=False):
    """Return -1 times the smallest eigenvalue of J, by differences or from all its columns."""
    kept = np.arange(position.size) % 3 < dimensions
    if whole:
        system.linearise(0.0, position)
        columns = np.zeros((position.size, *position.shape))
        for unit, out in zip(np.eye(position.size), columns, strict=True):
            system.jacobian_product(unit.reshape(-1, 3), out)
        matrix = columns.reshape(position.size, -1).T
    else:
        matrix = dense_jacobian(system, position)
    return -np.linalg.eigvals(matrix[np.ix_(kept, kept)]).real.min()


# the rate


@pytest.mark.parametrize("friction", [(0.0, 0.0), (0.05, 0.1)], ids=["bare", "friction"])
@pytest.mark.parametrize("n", [1, 2, 60])
@pytest.mark.parametrize("dimensions", [2, 3])
def test_the_rate_is_the_eigenvalue_of_the_dense_matrix(n, friction, dimensions):
    position, radius, young = cluster(n, 3)
    if dimensions == 2:
        position[:, 2] = 0.0
        position[:, :2] = 8.5 * np.stack([np.arange(n) % 8, np.arange(n) // 8], axis=1)
    system = mechanics(radius, young, friction=friction)
    found = largest_decay_rate(system, 0.0, position, dimensions=dimensions)
    # with friction velocities are known to some digits, and have no differences
    exact = dense_rate(system, position, dimensions, whole=friction[0] > 0.0)
    assert found == pytest.approx(exact, rel=0.01, abs=1e-12)
    assert found == largest_decay_rate(system, 0.0, position, dimensions=dimensions)
    apart = mechanics(np.full(n, 5.0), np.ones(n), friction=friction)
    far = np.arange(3.0 * n).reshape(n, 3) * 50.0
    assert largest_decay_rate(apart, 0.0, far, dimensions=dimensions) == 0.0


def test_a_look_at_the_velocity_is_never_above_the_rate_and_sees_rattling():
    position, radius, young = cluster(60, 3, spacing=0.8)
    system = mechanics(radius, young, duration=4000.0)
    rate = largest_decay_rate(system, 0.0, position)
    assert 0.0 < glance(system, 0.0, position) <= rate * (1 + 1e-9)
    rest = Euler(0.2 / rate).integrate(system, position).position
    now = largest_decay_rate(system, 4000.0, rest)
    assert glance(system, 4000.0, rest) < 0.5 * now
    system.begin(system.motion)
    shaken = rest + 0.01 * np.random.default_rng(1).normal(size=rest.shape)
    rattled = Euler(2.2 / now).integrate(system, shaken).position
    assert glance(system, 4000.0, rattled) > 0.8 * now / 1.1


# which methods


def test_every_explicit_method_with_a_fixed_step_has_its_limit():
    found = {name: limit_of(from_options(IntegratorOptions(method=name))) for name in METHODS}
    assert {name: x for name, x in found.items() if not np.isnan(x)} == EXPLICIT


def test_stabilised_methods_have_that_of_their_stages():
    assert limit_of(Rkc2(step=1.0, stages=5)) == pytest.approx(0.65 * 25, rel=0.1)
    assert np.isnan(limit_of(Rkc2(step=1.0)))
    assert np.isnan(limit_of(Rkc2()))


@dataclass(frozen=True)
class Mine:
    """Euler's method in the user's hands."""

    step: float
    info: ClassVar = MethodInfo("mine", order=1, stable=2.0)

    def integrate(self, system, position):
        return Euler(self.step).integrate(system, position)


def test_a_method_of_the_users_own_is_judged_by_its_own_limit():
    with pytest.raises(StepFailed, match="'mine' is beyond its limit of stability"):
        mc.run(scene_of("euler", 1.0), integrator=Mine(4.5))


# runs


@pytest.mark.parametrize(
    ("method", "step"), [("euler", 4.5), ("heun", 4.5), ("rk4", 6.3), ("ab2", 2.5)]
)
def test_a_run_beyond_the_limit_is_refused_with_the_numbers(method, step):
    with pytest.raises(StepFailed) as failed:
        mc.run(scene_of(method, step))
    assert f"{method!r} is beyond its limit of stability" in failed.value.problem
    assert f"must stay below {EXPLICIT[method]:g}" in failed.value.problem
    assert "integrator.step = " in failed.value.hint


@pytest.mark.parametrize(("method", "step"), [("heun", 3.0), ("rk4", 4.5), ("ab2", 1.5)])
def test_a_run_below_the_limit_ends_without_a_mark(method, step):
    summary = mc.run(scene_of(method, step)).summary()
    work = summary["integrator"]
    assert 0.5 < work["largest_stability_ratio"] < 1.0
    assert work["checks_beyond_stability"] == 0
    assert work["stability_checks"] >= 2
    assert not [note for note in summary["notes"] if "stability" in note]


def to_the_end(simulation):
    while not simulation.finished:
        simulation.step()


def test_rattling_cells_are_found_between_two_measurements(monkeypatch):
    """After the first measurements, with no further one affordable: their motion shows it."""
    scene = scene_of("heun", 3.0)
    simulation = Simulation(scene, threads=1)
    for _ in range(3):
        simulation.step()
    simulation.mover.integrator = from_options(IntegratorOptions(method="heun", step=4.9))
    known = simulation.stability._replace(rate=0.0)
    simulation.state = replace(simulation.state, stability=known)
    monkeypatch.setattr(stability, "_PASSES", 1e9)
    monkeypatch.setattr(stability, "_GLANCE", 0)
    measured = simulation.stability.measured
    with pytest.raises(StepFailed, match="beyond its limit of stability"):
        to_the_end(simulation)
    assert simulation.stability.measured > measured


def test_what_is_beyond_for_a_moment_is_marked_everywhere(tmp_path, monkeypatch):
    """λ is high at one look and low at all others."""
    rates = iter([0.1, 1.0])
    monkeypatch.setattr(stability, "rate_at", lambda *_: next(rates, 0.1))
    monkeypatch.setattr("multicell.report.page.PICTURES", {})
    result = mc.run(scene_of("heun", 3.0), output=tmp_path / "out")
    summary = result.summary()
    assert summary["integrator"]["checks_beyond_stability"] == 1
    assert summary["integrator"]["largest_stability_ratio"] == pytest.approx(1.5)
    (note,) = [note for note in summary["notes"] if "stability" in note]
    assert "'heun' was beyond its limit of stability 1 of the" in note
    assert "by a factor of up to 1.5" in note
    assert result.history["stability_ratio"].max() == pytest.approx(0.15)
    page = (tmp_path / "out" / "report.html").read_text()
    assert "beyond its limit of stability" in page


def test_checks_change_no_bit_and_a_resumed_run_does_the_same(tmp_path):
    scene = scene_of("heun", 3.0, **{"output.every": "30 min"})
    whole = mc.run(scene, output=tmp_path / "whole", report=False)
    plain = Simulation(scene, threads=1)
    plain._limit = float("nan")
    to_the_end(plain)
    assert whole.frames[-1].cells.position.tobytes() == plain.cells.position.tobytes()
    again = mc.resume(tmp_path / "whole", 1, output=tmp_path / "again", report=False)
    assert again.summary()["integrator"] == whole.summary()["integrator"]
    np.testing.assert_array_equal(
        again.history["stability_ratio"], whole.history["stability_ratio"]
    )


@pytest.mark.slow
def test_checks_take_a_fiftieth_of_the_counted_cost_in_the_long_run():
    simulation = Simulation(scene_of("euler", 0.1, duration="4 h"), threads=1)
    to_the_end(simulation)
    known = simulation.stability
    assert known.measured > 2
    assert known.looked > 0.0
    assert known.spent + known.looked <= SHARE * known.total


def test_methods_without_a_fixed_step_are_not_looked_at():
    result = mc.run(scene_of("auto", 1.0))
    assert np.isnan(result.history["stability_ratio"]).all()
    assert "stability_checks" not in result.summary()["integrator"]
    assert json.dumps(result.frames[-1].progress.stability) == "{}"


def test_comparisons_study_steps_beyond_the_limit(tmp_path):
    """Whatever a method does there is what they are for."""
    scene = mc.load_scene("settle").with_changes({"initial.count": 20, "duration": "20 min"})
    found = mc.compare(scene, methods=["euler"], ladder={"euler": [300.0]})
    assert [row["setting"] for row in found.table] == [300.0]
