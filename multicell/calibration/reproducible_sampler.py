"""A sampler for pyABC with the same draws on any number of workers.

pyABC's own sampler for Dask seeds each draw from the operating system, takes no limit on the number
of draws (a generation that accepts nothing would never end), and keeps nothing of a generation that
is stopped. Here the random numbers of a draw depend on its number alone, and a generation is the
first draws in the order of their numbers of which enough are accepted. So it is the same on any
workers, in whatever order draws end, and a stopped generation continues with its journal.
"""

from __future__ import annotations

import math
import random
import sys
import time as clock
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, final

import numpy as np
from pyabc.parameters import Parameter
from pyabc.random_variables import DistributionBase
from pyabc.sampler import Sampler

from multicell.calibration.pool import Call, Pool
from multicell.calibration.priors import Prior
from multicell.errors import OutputError
from multicell.results.documents import Lines


@final
class ReproducibleSampler(Sampler):  # type: ignore[misc]
    """Draws particles by numbers.

    - ``pool``: where draws are made
    - ``seed``: of all draws
    - ``most``: number of draws after which no generation is finished; that of earlier ones included
    - ``deadline``: the same by time (as of ``time.monotonic``)
    - ``journal``: file that keeps what the draws of the current generation came to; or None
    - ``progress``: called with generation, accepted, wanted and drawn
    """

    def __init__(
        self,
        pool: Pool,
        seed: int,
        *,
        most: float = math.inf,
        deadline: float = math.inf,
        journal: Path | None = None,
        progress: Callable[[int, int, int, int], None] | None = None,
    ) -> None:
        super().__init__()
        self._pool = pool
        self._seed = seed
        self._most = most
        self._deadline = deadline
        self._journal = journal
        self._lines: Lines | None = None
        self._progress = progress
        self.drawn = 0

    def sample_until_n_accepted(
        self,
        n: int,
        simulate_one: Callable[[], Any],
        t: int,
        *,
        max_eval: float = math.inf,
        all_accepted: bool = False,
        ana_vars: Any = None,
    ) -> Any:
        """Draw until ``n`` particles are accepted; pyABC calls this once a generation.

        The sample is not ``ok`` if a limit ended it first.
        """
        import cloudpickle

        generation = -1 if all_accepted else t
        work = cloudpickle.dumps((simulate_one, self._read(generation)))
        most = int(min(max_eval, self._most - self.drawn, sys.maxsize))
        particles: list[Any] = []  # in the order of their numbers, up to the n-th accepted one
        early: dict[int, Any] = {}  # those that have a gap before them
        accepted = in_any_order = 0

        def calls() -> Iterator[Call]:
            for number in range(most):
                if in_any_order >= n or clock.monotonic() > self._deadline:
                    return
                yield number, _draw, (work, self._seed, generation, number)

        with closing(self._pool.results(calls())) as results:
            for number, particle in results:
                self._write(generation, particle)
                early[number] = particle
                in_any_order += particle.accepted
                while accepted < n and len(particles) in early:
                    particles.append(early.pop(len(particles)))
                    accepted += particles[-1].accepted
                if self._progress is not None:
                    drawn = self.drawn + len(particles) + len(early)
                    self._progress(generation, min(in_any_order, n), n, drawn)
                if accepted >= n:
                    break
        sample = self._create_empty_sample()
        for particle in particles:
            sample.append(particle)
        self.nr_evaluations_ = len(particles)
        self.drawn += len(particles)
        sample.ok = sample.n_accepted == n
        return sample

    def _read(self, generation: int) -> dict[str, list[float]]:
        """Return what draws of a generation came to before it was stopped; forget earlier ones."""
        if self._journal is None:
            return {}
        self._lines = Lines(self._journal)
        entries = [_check_entry(entry, self._journal) for entry in self._lines.entries]
        # the calibration is in no database before the generation after it
        kept = [e for e in entries if e["generation"] >= generation or generation <= 0]
        if len(kept) < len(entries):
            self._lines.replace(kept)
        return {e["key"]: e["z"] for e in kept if e["generation"] == generation}

    def _write(self, generation: int, particle: Any) -> None:
        """Keep the residuals of a draw."""
        if self._lines is not None:
            found = particle.sum_stat
            entry = {"generation": generation, "key": found["key"]}
            self._lines.append([{**entry, "z": list(map(float, found["z"]))}])


@lru_cache(maxsize=1)
def _load(work: bytes) -> Any:
    """Return what all draws of a generation share."""
    import cloudpickle

    return cloudpickle.loads(work)


def _draw(work: bytes, seed: int, generation: int, number: int) -> Any:
    """Draw one particle with the random numbers of its number; done by a worker."""
    simulate_one, known = _load(work)
    # pyABC draws from the global generators
    words = np.random.SeedSequence((seed, generation + 1, number)).generate_state(4)
    np.random.seed(words)  # noqa: NPY002
    random.seed(int(words[0]))
    KNOWN.clear()
    KNOWN.update(known)
    return simulate_one()


KNOWN: Final[dict[str, list[float]]] = {}  # in a worker: what draws with some key came to before


@final
class Box(DistributionBase):  # type: ignore[misc]
    """The prior of places in the ranges; SciPy's takes longer than a cheap simulator."""

    def __init__(self, names: Sequence[str], prior: Prior) -> None:
        self._names, self._prior = tuple(names), prior

    def rvs(self, *args: Any, **kwargs: Any) -> Any:
        """Return a draw."""
        numbers: Any = ()
        while len(numbers) == 0:  # constraints may refuse it
            even = np.random.random_sample((1, len(self._names)))  # noqa: NPY002
            numbers = self._prior.places(even)
        return Parameter(dict(zip(self._names, map(float, numbers[0]), strict=True)))

    def pdf(self, x: Mapping[str, float]) -> float:
        """Return the density, up to a constant where there are constraints."""
        if not all(0.0 <= x[name] <= 1.0 for name in self._names):
            return 0.0
        place = np.array([[x[name] for name in self._names]])
        return float(np.exp(-0.5 * self._prior.loss(place)[0]))


@final
class OneModel:
    """The prior of models where there is one."""

    def rvs(self) -> int:
        """Return its number."""
        return 0

    def pmf(self, number: int) -> float:
        """Return that it is sure."""
        return 1.0


@final
class Model:
    """What pyABC takes for the model: parameters to (reading - datum) / σ.

    A class at module level, because it travels to workers.
    """

    __name__ = "runs"

    def __init__(self, problem: Any) -> None:
        self._problem = problem

    def __call__(self, parameters: Mapping[str, float]) -> dict[str, Any]:
        """Run all conditions with random numbers that no other draw has."""
        shares = [float(parameters[name]) for name in self._problem.names]
        seed = int(np.random.randint(0, 2**31 - 1))  # noqa: NPY002 - that of this draw's number
        key = f"{seed}:" + ",".join(map(float.hex, shares))
        if key in KNOWN:
            return {"z": np.array(KNOWN[key]), "key": key}
        state = np.random.get_state()  # noqa: NPY002
        found = self._problem.once(shares, seed)
        np.random.set_state(state)  # noqa: NPY002 - whether pyABC accepts depends on it
        return {"z": found, "key": key}


def _check_entry(entry: Any, journal: Path) -> dict[str, Any]:
    """Return an entry of a journal, which has a generation, a key and numbers."""
    if isinstance(entry, dict) and {"generation", "key", "z"} <= set(entry):
        return entry
    raise OutputError(f"'{journal}' is damaged: remove it, and its draws are made again")
