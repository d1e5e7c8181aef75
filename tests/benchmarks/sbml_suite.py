"""Read every time course of the SBML test suite, solve it, and compare with its results.

    python tests/benchmarks/sbml_suite.py SUITE [--levels all] [--compiled 40] [CASE …]

SUITE is a copy of github.com/sbmlteam/sbml-test-suite (its folder ``cases/semantic``, or any above
it). A case passes if all values are within the suite's own tolerances. The functions that are read
are called from Python and solved by SciPy's LSODA at 1e-9: this checks what is read, not how the
package solves it. ``--compiled N`` compiles the functions of every N-th case with numba, compares
their values with those in Python, and solves it by the package's own solver at 1e-8.
"""

from __future__ import annotations

import argparse
import csv
import re
import time
import warnings
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import libsbml
import numpy as np
from scipy.integrate import LSODA

from multicell.errors import SceneError
from multicell.networks.files import read_network
from multicell.networks.network import Network
from multicell.networks.solver import NetworkSolver

LEVELS = ("l3v2", "l3v1", "l2v5", "l2v4", "l2v3", "l2v2", "l2v1", "l1v2")
EVENTS = {"EventNoDelay", "EventWithDelay", "EventPriority"}
UNREAD = {"AlgebraicRule", "CSymbolDelay", "FastReaction", "EventWithDelay", "EventPriority"}
UNSAID = ("01399-sbml-l2v5",)
"""Documents that leave out what their case is about (here that the reaction is fast)."""
POINTS = 10
"""Points of a step at which conditions are looked at."""


@dataclass(frozen=True)
class Case:
    """A case: its folder, tags and settings."""

    folder: Path
    tags: frozenset[str]
    settings: dict[str, str]

    @property
    def number(self) -> str:
        return self.folder.name

    @property
    def group(self) -> str:
        """Where it stands in the table."""
        if any(tag.startswith("comp:") for tag in self.tags):
            return "compositions"
        if self.tags & UNREAD:
            return "delays, priorities, algebraic rules, fast reactions"
        return "plain events" if self.tags & EVENTS else "no events"

    def documents(self, levels: str) -> list[Path]:
        found = [self.folder / f"{self.number}-sbml-{level}.xml" for level in LEVELS]
        found = [path for path in found if path.exists() and path.stem not in UNSAID]
        return found if levels == "all" else found[:1]

    def names(self, key: str) -> list[str]:
        return [one for one in re.split(r"[,\s]+", self.settings.get(key, "")) if one]


def cases_in(folder: Path) -> Iterator[Case]:
    """Yield the time courses below a folder."""
    for path in sorted(folder.rglob("*-model.m")):
        if "stochastic" in path.parts or not re.fullmatch(r"\d{5}", path.parent.name):
            continue
        text = path.read_text(errors="replace")
        said = dict(re.findall(r"^(componentTags|testTags|testType):[ \t]*(.*)$", text, re.M))
        if said.get("testType", "").strip() != "TimeCourse":
            continue
        tags = re.split(r"[,\s]+", said.get("componentTags", "") + "," + said.get("testTags", ""))
        file = path.with_name(f"{path.parent.name}-settings.txt")
        rows = [line.split(":", 1) for line in file.read_text().splitlines() if ":" in line]
        settings = {key.strip(): value.strip() for key, value in rows}
        yield Case(path.parent, frozenset(filter(None, tags)), settings)


class Run:
    """A network while it is solved: time, states, constants, and which conditions hold."""

    def __init__(self, network: Network, start: float) -> None:
        self.network, self.t = network, start
        self.u = np.array(network.defaults)
        self.p, self.y = np.array(network.values), np.array(network.start)
        self.holds = [event.initial for event in network.events]
        self._out = np.empty(len(self.y))

    def slope(self, t: float, y: np.ndarray) -> np.ndarray:
        if not len(self._out):
            return np.zeros(1)  # LSODA wants a state
        self.network.rates(np.float64(t), y, self.u, self.p, self._out)
        return self._out.copy()

    def conditions(self, t: float, y: np.ndarray) -> list[bool]:
        events = self.network.events
        return [event.trigger(np.float64(t), y, self.u, self.p) > 0.0 for event in events]

    def execute(self) -> None:
        """Execute events until none is left; those that turn true meanwhile come last."""
        waiting: list[tuple[int, np.ndarray, np.ndarray]] = []
        for _ in range(1000):
            now = self.conditions(self.t, self.y)
            for k, (before, after) in enumerate(zip(self.holds, now, strict=True)):
                if after and not before:
                    waiting.append((k, self.y.copy(), self.p.copy()))
                if before and not after and not self.network.events[k].persistent:
                    waiting = [one for one in waiting if one[0] != k]
            self.holds = now
            if not waiting:
                return
            k, y, p = waiting.pop(0)
            t = np.float64(self.t)
            self.network.events[k].assign(t, self.y, self.u, self.p, y, p)
        raise RuntimeError("events without end")

    def observed(self) -> dict[str, float]:
        network, out = self.network, np.empty(len(self.network.observed))
        if network.observe is not None:
            network.observe(np.float64(self.t), self.y, self.u, self.p, out)
        names = (*network.states, *network.parameters, *network.observed)
        return dict(zip(names, (*self.y, *self.p, *out), strict=True))

    def advance(self, end: float, absolute: float, longest: float) -> None:
        while self.t < end:
            self._until_event(end, absolute, longest)

    def _until_event(self, end: float, absolute: float, longest: float) -> None:
        begin = self.y if len(self.y) else np.zeros(1)
        solver = LSODA(self.slope, self.t, begin, end, rtol=1e-9, atol=absolute, max_step=longest)
        while solver.status == "running":
            problem = solver.step()
            if solver.status == "failed":
                raise RuntimeError(problem or "LSODA failed")
            inside = solver.dense_output()
            at = self._first_change(inside, solver.t_old, solver.t)
            if at is not None:
                self._move(at, inside(at))
                self.execute()
                return
        self._move(end, solver.y)

    def _move(self, t: float, y: np.ndarray) -> None:
        self.t, self.y = t, np.array(y[: len(self._out)])

    def _first_change(self, inside, begin: float, end: float) -> float | None:
        if not self.network.events:
            return None
        low = begin
        for high in np.linspace(begin, end, POINTS + 1)[1:]:
            if self.conditions(high, inside(high)) != self.holds:
                return self._bisected(inside, low, high)
            low = high
        return None

    def _bisected(self, inside, low: float, high: float) -> float:
        while True:
            middle = 0.5 * (low + high)
            if not low < middle < high:
                return high
            if self.conditions(middle, inside(middle)) != self.holds:
                high = middle
            else:
                low = middle


class OwnRun(Run):
    """A network that the package's own solver solves, in one cell, with its events.

    What those of the start change is shown as :class:`Run` finds it; the solver executes them too.
    """

    def __init__(self, network: Network) -> None:
        super().__init__(network, 0.0)
        self._solver = NetworkSolver(network, relative=1e-8, absolute=1e-13)
        self._inside = self._solver.begin(1)
        self._none = np.zeros((1, 0))

    def advance(self, end: float, absolute: float, longest: float) -> None:
        parts = max(1, round((end - self.t) / longest))
        for begin, stop in pairwise(np.linspace(self.t, end, parts + 1)):
            self._inside = self._solver.advance(
                self._inside, self._none, self._none, begin, stop - begin
            )
        self.t, self.y, self.p = end, self._inside.y[0], self._inside.p[0]


def solved(case: Case, document: Path, run: Run) -> tuple[list[str], np.ndarray]:
    """Return the titles and the rows of a case's table as this package's network gives them."""
    start, length = float(case.settings["start"]), float(case.settings["duration"])
    count = int(case.settings["steps"])
    times = np.linspace(start, start + length, count + 1)
    absolute = min(1e-10, 1e-4 * float(case.settings["absolute"]))
    titles = case.names("variables")
    model = libsbml.readSBMLFromString(document.read_text())
    run.execute()
    rows = []
    for t in times:
        if t > run.t:
            run.advance(t, absolute, length / count)
        values = run.observed()
        rows.append([shown(case, model.getModel(), name, values) for name in titles])
    return titles, np.array(rows, dtype=float)


def shown(case: Case, model, name: str, values: dict[str, float]) -> float:
    """Return a value as a case asks for it: a species as an amount or as a concentration."""
    if name not in values:  # a stoichiometry that nothing changes
        found = model.getElementBySId(name)
        return found.getStoichiometry() if found.isSetStoichiometry() else 1.0
    value, species = values[name], model.getSpecies(name)
    if species is None:
        return value
    size = values.get(species.getCompartment(), 1.0)
    if species.getHasOnlySubstanceUnits():
        return value / size if name in case.names("concentration") else value
    return value * size if name in case.names("amount") else value


def expected(case: Case) -> tuple[list[str], np.ndarray]:
    with (case.folder / f"{case.number}-results.csv").open() as file:
        rows = [row for row in csv.reader(file) if row]
    return [title.strip() for title in rows[0]], np.array(rows[1:], dtype=float)


def verdict(case: Case, document: Path) -> tuple[str, str]:
    """Return "passed", "refused", "wrong" or "failed", and why."""
    try:
        network = read_network(document)
    except SceneError as error:
        return "refused", str(error)
    return compared(case, document, Run(network, 0.0))


def compared(case: Case, document: Path, run: Run) -> tuple[str, str]:
    """Return "passed", "wrong" or "failed" for the solution of a case, and why."""
    try:
        titles, rows = solved(case, document, run)
    except Exception as error:
        return "failed", f"{type(error).__name__}: {error}"
    wanted_titles, wanted = expected(case)
    titled = [one.lower() for one in wanted_titles[1:]]
    if titled == [one.lower() for one in titles]:
        columns = list(range(1, len(titles) + 1))
    else:  # in another order
        columns = [1 + titled.index(one.lower()) for one in titles]
    wanted = wanted[: len(rows), columns]
    allowed = float(case.settings["absolute"]) + float(case.settings["relative"]) * np.abs(wanted)
    with np.errstate(invalid="ignore"):
        same = (rows == wanted) | (np.isnan(rows) & np.isnan(wanted))
        off = np.where(same, 0.0, np.abs(rows - wanted) / allowed)
    if np.all(off <= 1.0):
        return "passed", ""
    k, column = np.unravel_index(np.argmax(np.nan_to_num(off, nan=np.inf)), off.shape)
    words = f"{titles[column]} in row {k}: {rows[k, column]:g} for {wanted[k, column]:g}"
    return "wrong", words


def compiled_alike(network: Network) -> str:
    """Return where compiled functions differ from those in Python; nothing if they do not."""
    from numba import njit

    rng = np.random.default_rng(1)
    y, u, p = (np.array(x) for x in (network.start, network.defaults, network.values))
    t = np.float64(0.3)
    for name, function, count in (
        ("rates", network.rates, len(y)),
        ("observe", network.observe, len(network.observed)),
    ):
        if function is None:
            continue
        jitted = njit(error_model="numpy")(function)
        for _ in range(3):
            a, b = np.empty(count), np.empty(count)
            function(t, y, u, p, a)
            jitted(t, y, u, p, b)
            if not np.allclose(a, b, rtol=1e-13, atol=0.0, equal_nan=True):
                return f"{name}: {a} in Python, {b} compiled"
            y = y * rng.uniform(0.5, 1.5, len(y))
    return ""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("suite", type=Path)
    parser.add_argument("cases", nargs="*", help="numbers of cases; all without any")
    parser.add_argument("--levels", choices=("newest", "all"), default="newest")
    parser.add_argument("--compiled", type=int, default=0, metavar="N")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    np.seterr(all="ignore")
    table: dict[str, Counter[str]] = {}
    begin, compiled = time.perf_counter(), 0
    for number, case in enumerate(cases_in(options.suite)):
        if options.cases and case.number not in options.cases:
            continue
        for document in case.documents(options.levels):
            found, why = verdict(case, document)
            table.setdefault(case.group, Counter())[found] += 1
            if found in ("wrong", "failed") or (found == "refused" and options.cases):
                print(f"{document.stem} {found}: {why}", flush=True)
            elif found == "refused" and case.group in ("no events", "plain events"):
                print(f"{document.stem} refused: {why}", flush=True)
        if options.compiled and number % options.compiled == 0 and found == "passed":
            compiled += 1
            network = read_network(document)
            if unlike := compiled_alike(network):
                print(f"{document.stem} compiled: {unlike}", flush=True)
            found, why = compared(case, document, OwnRun(network))
            table.setdefault(f"{case.group}, own solver", Counter())[found] += 1
            if found != "passed":
                print(f"{document.stem} by the own solver {found}: {why}", flush=True)
    kinds = ("passed", "refused", "wrong", "failed")
    print(f"\n| cases | number | {' | '.join(kinds)} |\n|---|---|---|---|---|---|")
    for group, counts in table.items():
        numbers = " | ".join(str(counts[kind]) for kind in kinds)
        print(f"| {group} | {counts.total()} | {numbers} |")
    print(f"\n{compiled} compiled; {time.perf_counter() - begin:.0f} s")


if __name__ == "__main__":
    main()
