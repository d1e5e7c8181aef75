"""Coupling steps of a stated stiffness: tissue at rest, growing, or with fresh daughters.

A cluster is built once for each number of cells and seed: a jittered close packing of cells of all
stages of the cycle, brought to rest. From it one coupling step of ten minutes is made in three
states, and the viscosity is chosen so that λΔt, the largest decay rate of the Jacobian at the
beginning times the length of the step, is what it should be.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, NamedTuple, final

import numpy as np
from scipy.sparse.linalg import LinearOperator, eigsh

import multicell as mc
from multicell.biology.division import divide
from multicell.biology.plan import biology_plan
from multicell.cells import SPHERE, Cells, FloatArray
from multicell.comparison.cache import cache_folder, source_hash
from multicell.comparison.conditioning import shift_starts
from multicell.comparison.ladders import find_method
from multicell.comparison.norms import gyration, pair_distances
from multicell.comparison.replay import Problem, Step, Trajectory, replay
from multicell.integrators.rosenbrock import Rosenbrock
from multicell.integrators.runge_kutta import Euler
from multicell.mechanics.system import Mechanics
from multicell.random import Purpose, normal
from multicell.scene.sizes import division_volume

STATES: Final = ("rest", "growing", "divided")
ACCURACIES: Final = (0.01, 0.001)
"""Largest error of the worst cell that is asked for, in mean radii."""
RIPE: Final = 0.02
"""Part of the cells that have come to division; in the state "divided" they have just divided."""
STRAIN, SHAKE = 0.01, 0.01
"""Of tissue at rest: its compression, and a shift of each coordinate in mean radii."""
PART: Final = 0.1
"""Shift that shows the conditioning of a step, in units of the accuracy that is asked for."""
SOLVED: Final = 1e-4
"""Tolerance of the reference, µm; its check and the shifted solutions have ten times that."""
_MILD = 1e3  # λΔt up to which a method of order 5 solves the reference
_SURE = 0.2  # part of the finest accuracy that the reference may be open by
_SOME = 400  # most cells among which distances are taken
_QUIET, _ROUNDS = 1e-3, 12  # µm moved in a round at which a cluster is at rest; most rounds


class Observables(NamedTuple):
    """Contact energy in fJ, radius of gyration in µm, sorted distances of pairs in µm."""

    energy: float
    gyration: float
    distances: FloatArray


@final
@dataclass(frozen=True, eq=False)
class Solved:
    """A problem with its reference.

    Attributes
    ----------
    problem : Problem
        One coupling step.
    stiffness : float
        λΔt.
    end : (n, 3) float64, µm
        Where the reference leads.
    observed : Observables
        Of the reference.
    uncertainty : float
        Difference from the check, worst cell in mean radii.
    conditioning : accuracy -> float
        What a shift by a tenth of the accuracy does to the worst cell, in mean radii.
    cost : float, s
        CPU time of the reference, without check and shifts.
    """

    problem: Problem
    stiffness: float
    end: FloatArray
    observed: Observables
    uncertainty: float
    conditioning: dict[float, float]
    cost: float

    def judged_by(self, accuracy: float) -> str:
        """Return the norm that decides: the worst cell, or observables where that hangs on luck."""
        luck = max(self.conditioning[accuracy], self.uncertainty)
        return "observable" if luck > accuracy else "worst"


def scene_of(count: int, seed: int) -> mc.Scene:
    """Return the scene that the cells, the law and the length of the step are taken from."""
    changes = {"initial.count": count, "seed": seed, "stop_cells": None, "initial.jitter": 0.15,
               "initial.stage": "asynchronous", "initial.spacing": 0.86}  # fmt: skip
    return mc.load_scene("grow-2000").with_changes(changes)


def cluster(count: int, seed: int, folder: Path | None = None) -> Cells:
    """Return the cells of a cluster at rest, a fiftieth of them ripe for division.

    Kept in ``folder``, by default that of references, under the hash of all sources.
    """
    cells = mc.Simulation(scene_of(count, seed), threads=1, integrator=Euler(1.0)).cells
    volume = cells.radius**3 * SPHERE
    ripe = np.argsort(volume)[-max(1, round(RIPE * count)) :]
    cells.radius[ripe] = np.cbrt(division_volume(scene_of(count, seed)) / SPHERE)
    path = _path({"cluster": [count, seed]}, folder)
    held = _kept(path)
    if held is None:
        held = {"position": _settled(scene_of(count, seed), cells)}
        _keep(path, held)
    cells.position = held["position"][cells.id]
    return cells


def problem(
    state: str, count: int, stiffness: float, seed: int, folder: Path | None = None
) -> Problem:
    """Return the coupling step of a state at which λΔt is ``stiffness``."""
    scene = scene_of(count, seed)
    cells = cluster(count, seed, folder)
    if state == "divided":
        cells, _ = divide(biology_plan(scene), cells, 0, count)
    simulation = mc.Simulation(scene, threads=1, cells=cells, integrator=Euler(1.0))
    cells, template = simulation.cells, simulation.prepared()  # in spatial order
    motion = template.motion
    if state == "rest":
        noise = normal(seed, Purpose.PLACEMENT, 1, cells.id, 3)
        cells.position = (1.0 - STRAIN) * cells.position + SHAKE * cells.radius.mean() * noise
        motion = replace(motion, radius_rate=np.zeros(len(cells)))
        template.begin(motion)
    length = motion.end - motion.begin
    factor = stiffness / (decay_rate(template, cells.position) * length)
    viscosity = scene.drag.viscosity / factor
    template = replace(template, viscosity=viscosity)
    template.begin(motion)
    scene = scene.with_changes({"drag.viscosity": viscosity, "duration": scene.coupling_step})
    start = np.array(cells.position)
    return Problem(scene, template, start, cells.radius, [Step(motion)], [start], 1)


def decay_rate(system: Mechanics, position: FloatArray) -> float:
    """Return the largest decay rate of the Jacobian at a state, 1/s, by the Lanczos method."""
    system.linearise(system.motion.begin, position)
    root = np.sqrt(system.motion.radius)[:, None]
    image = np.empty_like(position)

    def apply(vector: FloatArray) -> FloatArray:
        system.jacobian_product(np.ascontiguousarray(vector.reshape(-1, 3) / root), image)
        return (root * image).ravel()

    size = position.size
    start = np.random.default_rng(0).normal(size=size)
    symmetric = LinearOperator((size, size), matvec=apply, dtype=float)
    found = eigsh(symmetric, 1, which="SA", tol=1e-3, v0=start, return_eigenvectors=False)
    return -float(found[0])


def solved(
    state: str,
    count: int,
    stiffness: float,
    seed: int,
    folder: Path | None = None,
    tell: Callable[[str], None] = lambda _: None,
) -> Solved:
    """Return a coupling step with its reference, from the cache if it is there."""
    found = problem(state, count, stiffness, seed, folder)
    path = _path({"reference": [state, count, stiffness, seed], "by": [SOLVED, PART]}, folder)
    held = _kept(path)
    if held is None:
        held = _reference(found, "dopri5" if stiffness <= _MILD else "rkc2", tell)
        _keep(path, held)
    conditioning = dict(zip(ACCURACIES, held["conditioning"].tolist(), strict=True))
    numbers = (float(held[name]) for name in ("uncertainty", "cost"))
    uncertainty, cost = numbers
    seen = observed(found, held["end"])
    return Solved(found, stiffness, held["end"], seen, uncertainty, conditioning, cost)


def _reference(
    step: Problem, method: str, tell: Callable[[str], None]
) -> dict[str, FloatArray | float]:
    """Return end, uncertainty, conditioning and cost; a tighter one where that is too open."""
    radius, atol = step.mean_radius, SOLVED
    turned = find_method(method, step.scene, radius)

    def run(task: Problem, tolerance: float) -> Trajectory:
        tell(f"reference: {method} at {tolerance:g} µm")
        ends = replay(task, turned.make(tolerance / radius))
        if not ends.done:
            raise SystemExit(f"the reference by {method} failed: {ends.problem}")
        return ends

    check = run(step, 10.0 * atol)
    shifts = [run(shift_starts(step, PART * a * radius), 10.0 * atol) for a in ACCURACIES]
    end = run(step, atol)
    conditioning = [_worst(s.positions[0], check.positions[0]) / radius for s in shifts]
    uncertainty = _worst(end.positions[0], check.positions[0]) / radius
    if uncertainty > _SURE * ACCURACIES[-1] and conditioning[-1] <= ACCURACIES[-1]:
        check, end = end, run(step, 0.1 * atol)
        uncertainty = _worst(end.positions[0], check.positions[0]) / radius
    return {"end": end.positions[0], "uncertainty": uncertainty, "cost": end.cpu,
            "conditioning": np.array(conditioning)}  # fmt: skip


def errors(step: Solved, end: FloatArray) -> dict[str, float]:
    """Return the errors of an end: of the worst cell, and of observables, both dimensionless.

    ``observable`` is the largest of those of the contact energy (relative), of the radius of
    gyration and of the distribution of the distances of pairs (Wasserstein; both in mean radii).
    """
    radius, exact = step.problem.mean_radius, step.observed
    found = observed(step.problem, end)
    observable = max(
        abs(found.energy - exact.energy) / abs(exact.energy),
        abs(found.gyration - exact.gyration) / radius,
        float(np.abs(found.distances - exact.distances).mean()) / radius,
    )
    return {"worst": _worst(end, step.end) / radius, "observable": observable}


def observed(step: Problem, end: FloatArray) -> Observables:
    """Return the observables of an end; distances are those among some hundred cells."""
    system, motion = step.system(), step.steps[0].motion
    system.begin(motion)
    some = end[:: -(-len(end) // _SOME)]
    return Observables(system.energy(motion.end, end), gyration(end), pair_distances(some))


def _worst(position: FloatArray, other: FloatArray) -> float:
    return float(np.sqrt(np.square(position - other).sum(axis=1).max()))


def _settled(scene: mc.Scene, cells: Cells) -> FloatArray:
    """Return the positions of the cells at rest, in the order of their identities.

    Sizes of the whole cluster relax most slowly: after each short relaxation it is scaled to the
    size at which its mean pressure vanishes, and a long one follows.
    """
    simulation = mc.Simulation(scene, threads=1, cells=cells, integrator=Euler(1.0))
    cells, system = simulation.cells, simulation.prepared()
    position = cells.position
    # damps all that is stiff; BDF would leave it moving within its tolerance
    solver = Rosenbrock(1e-6, 0.01, max_steps=1_000_000)
    hours = [0.1, 0.1, 0.2, 0.5, 1.0, *[10.0] * _ROUNDS]
    for k, length in enumerate(hours):
        motion = replace(
            system.motion, radius_rate=np.zeros(len(cells)), begin=0.0, end=3600.0 * length
        )
        system.begin(motion)
        before = position
        outcome = solver.integrate(system, position)
        if not outcome.done:
            raise SystemExit(f"the cluster does not come to rest: {outcome.problem}")
        position = outcome.position
        if length == hours[-1] and _worst(position, before) < _QUIET:
            break
        if k < len(hours) - _ROUNDS:
            position = _unloaded(system, position)
    return np.asarray(position[np.argsort(cells.id)])


def _unloaded(system: Mechanics, position: FloatArray) -> FloatArray:
    """Return the positions scaled to where the mean pressure vanishes, within 10 %."""
    from scipy.optimize import brentq

    volume = system.motion.radius**3

    def mean(scale: float) -> float:
        return float((volume * system.pressure(0.0, scale * position)).mean())

    low, high = 0.9, 1.1
    if mean(low) * mean(high) >= 0.0:
        return position
    return float(brentq(mean, low, high, xtol=1e-4)) * position


def _path(about: dict[str, Any], folder: Path | None) -> Path:
    described = json.dumps([about, source_hash()], sort_keys=True)
    own = Path(__file__).read_bytes()
    name = hashlib.sha256(described.encode() + own).hexdigest()[:32]
    return (cache_folder() if folder is None else folder) / f"phase-{name}.npz"


def _kept(path: Path) -> dict[str, Any] | None:
    if not path.exists():
        return None
    with np.load(path, allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def _keep(path: Path, arrays: dict[str, Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    # two processes that share the work may build the same cluster
    part = path.with_name(f"{path.stem}.{os.getpid()}.npz")
    np.savez(part, **arrays)
    part.replace(path)
