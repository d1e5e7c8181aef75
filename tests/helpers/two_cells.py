"""Two Hertz cells that part, known in closed form, and methods with planted faults."""

import math
from dataclasses import dataclass

import numpy as np

from multicell.comparison.ladders import Method
from multicell.comparison.norms import NORMS, WORST_CELL
from multicell.comparison.result import WorkPrecision
from multicell.comparison.work_precision import compare
from multicell.integrators.base import Outcome
from multicell.scene.scene import Scene

PAIR = Scene.from_dict(
    {
        "title": "Two Hertz cells <b>part</b>",
        "duration": "300 s",
        "coupling_step": "60 s",
        "initial": {"count": 2, "spacing": 0.8},
        "cells": {"young_variation": 0.0},
        "contact": {"law": "hertz"},
    }
)
GROWING = Scene.from_dict(
    {
        "title": "Twelve cells grow",
        "duration": "12 h",
        "coupling_step": "20 min",
        "initial": {"count": 12, "stage": "uniform"},
        "growth": {"cycle_time": "15 h"},
    }
)
RADIUS = PAIR.cells.division_radius * 0.5 ** (1 / 3)


def apart_after(time, distance=1.6 * RADIUS):
    """Return the distance: dh/dt = -2 k h^1.5 / Γ, so that h^-1/2 grows linearly."""
    modulus = 1.0 / (0.75 * (1.0 - 0.25) * 2.0 / PAIR.cells.young)
    stiff = modulus * math.sqrt(0.5 * RADIUS)
    drag = 6.0 * math.pi * PAIR.drag.viscosity * RADIUS
    return 2.0 * RADIUS - ((2.0 * RADIUS - distance) ** -0.5 + stiff * time / drag) ** -2


def parted(position, length):
    middle, axis = position.mean(axis=0), position[1] - position[0]
    distance = np.linalg.norm(axis)
    half = 0.5 * apart_after(length, distance) * axis / distance
    return np.array([middle - half, middle + half])


@dataclass(frozen=True)
class Planted:
    """The exact solution of the run, with an error: shifted, or drawn apart."""

    shift: float = 0.0
    apart: float = 0.0
    fail_after: float = math.inf
    words: str = "the planted end"

    def integrate(self, system, position):
        """Return the exact solution at the end of the coupling step, whatever the start."""
        end = system.motion.end
        system.work.evaluations += 7
        if end > self.fail_after:
            return Outcome(end, position, self.words, "plant none", 0)
        axis = (position[1] - position[0]) / np.linalg.norm(position[1] - position[0])
        half = 0.5 * (apart_after(end) + self.apart) * axis
        middle = np.array([0.0, 0.0, self.shift])
        return Outcome(end, np.array([middle - half, middle + half]))


@dataclass(frozen=True)
class PlantedInSteps:
    """The exact solution from where a step starts, shifted by a little in every step."""

    shift: float = 0.0
    fail_in: float = math.inf

    def integrate(self, system, position):
        """Return the end of a step, or the planted failure in the step that ends after it."""
        begin, end = system.motion.begin, system.motion.end
        system.work.evaluations += 3
        if begin <= self.fail_in < end:
            return Outcome(begin, position, "the planted end", "plant none", 0)
        return Outcome(end, parted(position, end - begin) + np.array([0, 0, self.shift]))


def step_method(make, name="planted"):
    return Method(name, "step", make)


EXACT = step_method(lambda _: Planted(), "exact")
BOTH_EXACT = [(EXACT, 1.0), (EXACT, 1.0)]


def compared(methods, ladder, scene=PAIR, **options):
    # however slow a busy machine is, no setting is left out
    patient = {"patience": 1e6, "budget": 1e9}
    options = {"references": BOTH_EXACT, "repeats": 1, **patient, **options}
    return compare(scene, methods, {"step": ladder}, **options)


IN_STEPS = step_method(lambda _: PlantedInSteps(), "exact")
BOTH_IN_STEPS = [(IN_STEPS, 1.0), (IN_STEPS, 1.0)]


def compared_in_steps(methods, ladder, scene=PAIR, **options):
    usual = {"references": BOTH_IN_STEPS, "stepwise": True}
    return compared(methods, ladder, scene, **usual | options)


def only(result, **wanted):
    rows = [r for r in result.table if all(r[k] == v for k, v in wanted.items())]
    assert len(rows) == 1
    return rows[0]


def result_of(solves, failed=(), *, named=(), uncertainty=1e-9, scene=PAIR):
    """Return a comparison with solves (method, wall, error) and failures (method, spent)."""
    errors = (f"error_{norm}" for norm in NORMS)
    unknown = dict.fromkeys((*errors, *WORST_CELL.values(), "cpu", "cost"), math.nan)
    counts = dict.fromkeys(
        ("evaluations", "linearisations", "jacobian_products", "steps"), math.nan
    )
    start = {"control": "tolerance", "words": "", "mode": "whole run", **unknown, **counts}
    table = [
        {"method": method, **start, "setting": 1.0, "status": "done", "wall": wall, "spent": wall}
        | {"cpu": wall, "cost": 1e3 * wall, **dict.fromkeys(counts, 1)}
        | {f"error_{norm}": error for norm in NORMS}
        for method, wall, error in solves
    ]
    table += [
        {"method": method, **start, "setting": 2.0, "status": "failed", "wall": math.nan}
        | {"spent": spent, "words": "planted"}
        for method, spent in failed
    ]
    facts = {
        "cells": [2, 2], "time": 300.0, "looks": {}, "named": list(named), "coupling_steps": 5,
        "steps_with_events": 0, "reference": "planted", "threads": 1, "largest_decay_rate": 1.0,
        "versions": {}, "mode": "whole run", "stepwise": 0,
    }  # fmt: skip
    return WorkPrecision(scene, table, facts, dict.fromkeys(NORMS, uncertainty))


def ladders(names):
    """Return three solves of each method, the first ones on the front."""
    return [
        (name, (k + 1.0) * 10.0**level, 0.3 * (k + 1.0) * 0.01**level)
        for k, name in enumerate(names)
        for level in range(3)
    ]
