"""Problems of fitting whose simulators cost nothing and whose posteriors are known."""

from __future__ import annotations

import math
import os
import signal
from dataclasses import dataclass
from threading import Timer

import numpy as np

import multicell as mc
from multicell.calibration.fitting.emulator import emulator
from multicell.calibration.fitting.likelihood import fresh
from multicell.calibration.fitting.pool import Pool
from multicell.calibration.fitting.problem import FitProblem
from multicell.calibration.fitting.result import Fit
from multicell.calibration.fitting.search import Search
from multicell.calibration.fitting.simulator import Reading, SceneSimulator
from multicell.measured.data import Condition, Datum, Measured, read_data
from multicell.studies.axes import Range

MATRIX = [[1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, -1.0]]
"""Four data of two parameters that determine both."""

CALLS = []
"""Shares, condition and seed of every call of a simulator in this process."""


def calls_of(work):
    """Return the result of some work, and the calls of simulators that it made."""
    before = len(CALLS)
    try:
        found = work()
    except KeyboardInterrupt:
        found = None
    return found, CALLS[before:]


def stopping(calls):
    """Return a pool that stops after some calls, as a process does that is killed."""
    left = iter(range(calls))

    def call(function, *arguments):
        if next(left, None) is None:
            raise KeyboardInterrupt
        return function(*arguments)

    return Pool(call=call)


def killed(arguments, calls):
    """Run a command line of ``multicell`` that is killed (-9) in a call of its simulator."""
    from multicell.cli.main import main

    usual, left = SceneSimulator.__call__, iter(range(calls - 1, -1, -1))

    def called(self, *more):
        if next(left) == 0:
            Timer(0.01, os.kill, (os.getpid(), signal.SIGKILL)).start()
        return usual(self, *more)

    SceneSimulator.__call__ = called
    main(arguments)


SCENE = mc.load_scene("growth")


@dataclass(frozen=True)
class Linear:
    """Readings A x + noise: with normal errors the posterior is a normal one.

    Every call is noted in ``CALLS``, also of copies that were sent somewhere in this process.
    """

    matrix: tuple[tuple[float, ...], ...]
    noise: float = 0.0
    bend: float = 0.0

    def __call__(self, shares, condition, seed):
        CALLS.append((tuple(shares), condition, seed))
        x = np.asarray(shares)
        found = np.asarray(self.matrix) @ (x + self.bend * x**2)
        # the same seed gives the same numbers at all parameters
        found = found + self.noise * np.random.default_rng(seed).standard_normal(len(found))
        return Reading(tuple(map(float, found)))


@dataclass(frozen=True)
class Growing:
    """A diameter and a core over time: p0 sets the rate of growth, p1 the depth of the rim.

    ``scatter`` says how the runs of a seed are off at all times: ``"independent"``, ``"shared"``
    (the same at all times), ``"walk"`` (steps add up). With ``kink`` the second observable is a
    core, which is 0 until the radius exceeds the rim. With ``common`` a seed gives the same
    numbers at all parameters; otherwise others at each, as where tissues are chaotic.
    """

    scatter: str
    noise: float = 4.0
    kink: bool = False
    common: bool = True

    def mean(self, shares):
        """Return results of runs without scatter, um: six times of each observable."""
        rate, depth = shares
        times = np.arange(1.0, 7.0)
        size = 60.0 * np.exp(0.12 * times * (0.5 + rate))
        core = size - 60.0 - 100.0 * depth if self.kink else 40.0 + 20.0 * depth * times
        return np.concatenate([size, np.maximum(core, 0.0)])

    def drawn(self, shares, rng):
        """Return the result of one tissue, um."""
        found = self.mean(shares)
        steps = self.noise * rng.standard_normal((2, 6))
        if self.scatter == "shared":
            steps = np.repeat(steps[:, :1], 6, axis=1)
        elif self.scatter == "walk":
            steps = steps.cumsum(axis=1) / 2.0
        return np.maximum(found + np.where(found > 0.0, steps.ravel(), 0.0), 0.0)

    def __call__(self, shares, condition, seed):
        more = () if self.common else tuple(int(1e9 * x) for x in shares)
        found = self.drawn(shares, np.random.default_rng((seed, *more)))
        return Reading(tuple(map(float, found)))


def growing(simulator, truth, rng, sigma=4.0, seeds=2):
    """Return a problem whose data one tissue at ``truth`` gave, measured with an error in um."""
    values = simulator.drawn(truth, rng) + sigma * rng.standard_normal(12)
    names = ["diameter"] * 6 + ["necrotic_radius"] * 6
    data = tuple(
        Datum(name, float(v), sigma, False, False, 3600.0 * (k % 6 + 1), 0, f"row {k}")
        for k, (name, v) in enumerate(zip(names, np.maximum(values, 0.0), strict=True))
    )
    units = {"diameter": "um", "necrotic_radius": "um"}
    ranges = tuple(Range(f"toy.p{k}", 0.0, 1.0, "", False, f"p{k}", False) for k in range(2))
    first = int(rng.integers(2**40))
    condition = (Condition("only", {}, SCENE),)
    found = Measured(data, condition, units, "cheap")
    return FitProblem(found, ranges, simulator, tuple(range(first, first + seeds)))


def measured(values, sigma):
    """Return data of one condition with given values and deviations, at as many hours.

    They are of an observable that may be negative.
    """
    data = tuple(
        Datum("force_toy_x", float(v), float(s), False, False, 3600.0 * (k + 1), 0, f"row {k}")
        for k, (v, s) in enumerate(zip(values, np.broadcast_to(sigma, len(values)), strict=True))
    )
    condition = Condition("only", {}, SCENE)
    return Measured(data, (condition,), {"force_toy_x": "nN"}, "cheap")


def linear(matrix, values, sigma, *, noise=0.0, bend=0.0, seeds=1, first=0):
    """Return a problem with as many parameters between 0 and 1 as the matrix has columns."""
    matrix = tuple(tuple(map(float, row)) for row in matrix)
    ranges = tuple(
        Range(f"toy.p{k}", 0.0, 1.0, "", False, f"p{k}", False) for k in range(len(matrix[0]))
    )
    return FitProblem(
        measured(values, sigma),
        ranges,
        Linear(matrix, noise, bend),
        tuple(range(first, first + seeds)),
    )


def through(shares, residuals, **more):
    """Return an emulator through exact residuals (k, n) at some parameters (k, d)."""
    loss = (residuals**2).sum(axis=1)
    return emulator(shares, residuals, np.zeros_like(residuals), loss, **more)


def read(text, folder, scene, **options):
    """Return the data of a table of text, written to a file."""
    file = folder / "growth.csv"
    file.write_text(text, encoding="utf-8")
    return read_data(file, scene, **options)


@dataclass(frozen=True)
class Steps:
    """Readings that jump: sums of steps at random places, and a core that begins at once."""

    heights: tuple[tuple[float, ...], ...]
    places: tuple[tuple[float, ...], ...]
    ways: tuple[tuple[float, ...], ...]

    @classmethod
    def drawn(cls, seed, data=6, steps=5, parameters=2):
        rng = np.random.default_rng(seed)
        ways = rng.normal(size=(steps, parameters))
        shape = data, steps
        return cls(*(tuple(map(tuple, x)) for x in (
            rng.normal(scale=30.0, size=shape), rng.uniform(-0.6, 1.0, shape), ways,
        )))  # fmt: skip

    def __call__(self, shares, condition, seed):
        along = np.asarray(self.ways) @ np.asarray(shares)
        jumps = along[None, :] > np.asarray(self.places)
        found = (np.asarray(self.heights) * jumps).sum(axis=1) + 5.0 * sum(shares)
        return Reading(tuple(map(float, found)))


def jumping(seed):
    return jumping_from(seed)[0]


def jumping_from(seed):
    """Return a problem and the parameters that its data come from."""
    simulator = Steps.drawn(seed)
    rng = np.random.default_rng(1000 + seed)
    true = rng.random(2)
    truth = simulator(true, 0, 0).values
    ranges = tuple(Range(f"toy.p{k}", 0.0, 1.0, "", False, f"p{k}", False) for k in range(2))
    return FitProblem(measured(truth + rng.normal(size=6), 1.0), ranges, simulator, (1,)), true


def exact(problem):
    """Return mean and covariance of the posterior of a linear problem whose ends do not count.

    Scatter of the runs adds to the variance of the data.
    """
    a = np.asarray(problem.simulator.matrix)
    weights = 1.0 / (problem.sigma**2 + problem.simulator.noise**2)
    covariance = np.linalg.inv(a.T @ (weights[:, None] * a))
    return covariance @ (a.T @ (weights * problem.observed)), covariance


def fitted(problem, points=30):
    """Return the fit of a problem by the best point."""
    search = Search(problem, None, seed=1)
    known = search.run(Pool(), points)
    facts = {"sd": 0.1, "seconds": 1.0, "sets_of_parameters": points}
    again = fresh(problem, search, Pool())
    if again.problem is None:
        return Fit(problem, SCENE, known, None, facts, again)
    known = search.on(again.problem).evaluations()
    return Fit(again.problem, SCENE, known, None, facts, again, search.readings, problem)


CASES = {
    "independent": Growing("independent"),
    "shared over time": Growing("shared"),
    "random walk": Growing("walk"),
    "kink": Growing("walk", kink=True),
    "chaotic": Growing("shared", common=False),
}


def check(hits):
    """Check coverage, (repeats, 2, parameters), against what is said."""
    print(np.mean(hits, axis=0).tolist())
    for level, shares in zip((0.8, 0.95), np.mean(hits, axis=0), strict=True):
        bound = 3.0 * math.sqrt(level * (1.0 - level) / len(hits))
        assert np.abs(shares - level).max() <= bound, f"{level}: {shares}"
