"""Measured data of runs: a table with units in its header, checked before anything runs.

One row for each measurement, from a CSV file or a pandas ``DataFrame``. What a column holds is said
by its title, ``NAME / UNIT`` (or ``NAME [UNIT]``)::

    time / h, diameter / um, diameter sd / um, cells, nutrients.oxygen.boundary / mM
    48,       272,           14,               1472,  0.2
    96,       370,           19,               4409,  0.2

=====================  ===========================================================================
``time / h``           when it was measured; empty: at the end of the run
``start / h``          age of the culture, on the clock of ``time``, at which the run begins
``at diameter / um``   instead of a time: when this observable first has this value
an observable          any number of a run's history; of its summary for rows without a time.
                       An empty field was not measured
``diameter sd / um``   error of measuring one tissue, as a standard deviation; ``/ %`` of the value
``diameter n``         how many tissues the value is the mean of: their errors and their scatter
                       over the seeds of runs count as 1/n
``diameter sem / um``  in place of both: the standard error of the mean over tissues, which holds
                       their scatter; ``/ %`` of the value
a key of the scene     the conditions of the row
``label``              name of the row's condition, for pictures
=====================  ===========================================================================

Rows with the same conditions, time and observable are replicates: one datum, their mean, with as
many tissues as there are rows. Tissues of different times are taken to be the same ones: their
scatter is correlated over time as that of runs is. Where others were measured each time, a standard
error of the mean says so, as it counts as independent. The error of a length of 0, such as a core
that has not begun, is the radius of a cell at division where the table states it as a part of the
value or not at all. Lines that begin with ``#`` are remarks. What a datum is compared with, and in
which unit of deviation, is settled here too (:class:`Datum`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, final

from multicell.calibration.columns import Column, columns_of
from multicell.errors import DataError, SceneError
from multicell.results.observable import represented
from multicell.scene.scene import Scene
from multicell.schema import leaves
from multicell.studies.observed import at_the_end, in_history, suggest
from multicell.tables.fields import Table, read_table
from multicell.units import to_base

MAX_BYTES: Final = 10_000_000  # of a file of measured data

ASSUMED: Final = 0.1
"""Relative standard deviation of data that come without one, unless another one is given."""


@final
@dataclass(frozen=True)
class Datum:
    """One measured number, and what to compare with it.

    - ``observable``: name in the history of a run, or in its summary (dots between names)
    - ``value``: measured, in base units
    - ``sigma``: standard deviation of the measurement: in base units, or of the logarithm of the
      value where ``log``
    - ``log``: whether logarithms are compared. They are for numbers of cells whose deviation is
      relative (or assumed): populations grow over decades.
    - ``assumed``: whether the data do not state a standard deviation
    - ``time``: simulated time in s; None: at the end, or ``at``
    - ``at``: observable and its value (base unit) that state when; or None
    - ``condition``: number of the condition
    - ``place``: row in the source, in words
    - ``tissues``: how many tissues the value is the mean of; infinite where ``sigma`` holds their
      scatter
    """

    observable: str
    value: float
    sigma: float
    log: bool
    assumed: bool
    time: float | None
    at: tuple[str, float] | None
    condition: int
    place: str
    tissues: float = 1.0

    @property
    def deviation(self) -> float:
        """The standard deviation in base units; that of a logarithm times the value."""
        return self.sigma * self.value if self.log else self.sigma

    def scaled(self, value: float) -> float:
        """Return a value on the scale of the comparison; NaN where it has none there."""
        if not self.log:
            return value
        return math.log(value) if value > 0.0 else math.nan


@final
@dataclass(frozen=True)
class Condition:
    """What some of the data were measured under.

    - ``label``: for pictures and tables
    - ``changes``: dotted keys of the scene with their values, as :meth:`Scene.with_changes` takes
      them
    - ``scene``: the scene of this condition; it lasts as long as its data need
    """

    label: str
    changes: Mapping[str, Any]
    scene: Scene


@final
@dataclass(frozen=True)
class Measured:
    """All data of a fit.

    - ``data``: in the order of rows and columns
    - ``conditions``: in the order in which the rows name them
    - ``units``: base unit by observable
    - ``source``: name of the file, or what the table was
    """

    data: tuple[Datum, ...]
    conditions: tuple[Condition, ...]
    units: Mapping[str, str]
    source: str
    numbers: Mapping[int, tuple[int, ...]] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        found: dict[int, list[int]] = {k: [] for k in range(len(self.conditions))}
        for number, datum in enumerate(self.data):
            found[datum.condition].append(number)
        object.__setattr__(self, "numbers", {k: tuple(v) for k, v in found.items()})

    def of(self, condition: int) -> list[Datum]:
        """Return the data of one condition; their places in ``data`` are ``numbers[condition]``."""
        return [self.data[k] for k in self.numbers[condition]]


def read_data(
    source: Any, scene: Scene, *, start: float | str | None = None, sd: float = ASSUMED
) -> Measured:
    """Read measured data of a scene.

    - ``source``: path of a CSV file, a pandas ``DataFrame`` with the same titles, or a mapping of
      titles to columns
    - ``scene``: what is fitted. A condition's runs end with its last datum, be that before the
      scene's end or after it; where a row has no time, with the scene.
    - ``start``: time of the data at which runs begin, in s or with a unit, where no column says so
    - ``sd``: relative standard deviation of data without one

    Raises DataError with row and column, for a title without a unit, a column that is no observable
    of the scene and no key of it, text or NaN in place of a number, a standard deviation that is
    not above 0, a time outside the run, and a table without data.
    """
    if not (isinstance(sd, int | float) and 0.0 < sd < math.inf):
        raise DataError("sd", f"is {sd!r}, must be a relative standard deviation above 0")
    table = source if isinstance(source, Table) else read_table(source, MAX_BYTES)
    columns = columns_of(table, scene)
    rows = _Rows(table, columns, scene, start, float(sd))
    for number in range(len(table.rows)):
        rows.read(number)
    return rows.measured()


@final
class _Rows:
    """Reads the rows of a table one by one."""

    def __init__(
        self,
        table: Table,
        columns: Sequence[Column],
        scene: Scene,
        start: float | str | None,
        sd: float,
    ) -> None:
        self._table = table
        self._columns = columns
        self._places = {(column.kind, column.name): k for k, column in enumerate(columns)}
        self._scene = scene
        self._sd = sd
        self._start = self._checked_start(start)
        self._keys: dict[tuple[tuple[str, Any], ...], int] = {}
        self._labels: list[str] = []
        self._scenes: list[Scene] = []
        self._data: list[Datum] = []

    def read(self, row: int) -> None:
        """Read one row."""
        condition = self._condition(row)
        time, at = self._when(row)
        scene = self._scenes[condition]
        timed, known = in_history(scene), in_history(scene) | at_the_end(scene)
        found = 0
        for place, column in enumerate(self._columns):
            if column.kind != "value" or not self._text(row, place):
                continue
            where = self._where(row, place)
            if column.name not in known:
                problem = f"'{column.name}' is no observable of the scene under these conditions"
                raise DataError(where, problem, suggest(column.name, known))
            if column.name not in timed and (time is not None or at is not None):
                raise DataError(
                    where,
                    f"'{column.name}' is known at the end of a run only",
                    "Leave the time of this row empty.",
                )
            value = self._number(row, place)
            self._data.append(self._datum(row, column, value, where, condition, time, at))
            found += 1
        if found == 0:
            raise DataError(self._where(row), "has no measured value")

    def measured(self) -> Measured:
        """Return what was read."""
        conditions = tuple(
            Condition(label or f"condition {k + 1}", dict(key), self._lasting(k))
            for k, (key, label) in enumerate(zip(self._keys, self._labels, strict=True))
        )
        known = self._all_units()
        units = {d.observable: known[d.observable] for d in self._data}
        return Measured(tuple(_group(self._data)), conditions, units, self._table.name)

    def _datum(
        self, row: int, column: Column, value: float, where: str, condition: int,
        time: float | None, at: tuple[str, float] | None,
    ) -> Datum:  # fmt: skip
        """Return a datum with what it is compared in."""
        given = self._deviation(row, column.name, "sd")
        mean, count = self._deviation(row, column.name, "sem"), self._tissues(row, column.name)
        if mean is not None and (given is not None or count is not None):
            problem = f"has both '{column.name} sem' and '{column.name} sd' or '{column.name} n'"
            raise DataError(where, problem, "The error of the mean stands in place of both.")
        tissues = math.inf if mean is not None else count or 1.0
        given = mean or given
        relative = given[0] if given is not None and given[1] else None
        if given is None:
            relative = self._sd
        log = column.name == "cells" and relative is not None
        if relative is not None and value == 0.0:
            if log or column.base != "um":
                raise DataError(where, "is 0, of which a relative standard deviation says nothing",
                                f"Add a column '{column.name} sd' with its unit.")  # fmt: skip
            sigma = self._scenes[condition].cells.division_radius
        elif relative is None:
            assert given is not None
            sigma = given[0]
        else:
            sigma = relative if log else relative * abs(value)
        return Datum(
            column.name, value, sigma / math.sqrt(count or 1.0), log, given is None, time, at,
            condition, self._table.places[row], tissues,
        )  # fmt: skip

    def _field(self, row: int, kind: str, name: str) -> tuple[float, int] | None:
        """Return the number in a column and its place; None without a column or a value."""
        place = self._places.get((kind, name))
        if place is None or not self._text(row, place):
            return None
        return self._number(row, place), place

    def _tissues(self, row: int, name: str) -> float | None:
        """Return how many tissues an observable was measured on, if a column says so."""
        value, place = self._field(row, "n", name) or (None, 0)
        if value is not None and (value < 1.0 or value != int(value)):
            problem = f"is {self._text(row, place)}, must be a whole number of at least 1"
            raise DataError(self._where(row, place), problem)
        return value

    def _deviation(self, row: int, name: str, kind: str) -> tuple[float, bool] | None:
        """Return an error of an observable and whether it is relative, if known."""
        found = self._field(row, kind, name)
        if found is None:
            return None
        value, place = found
        if not value > 0.0:
            problem = f"is {self._text(row, place)}, must be above 0"
            raise DataError(self._where(row, place), problem, "Leave it empty where it is unknown.")
        return value, self._columns[place].relative

    def _when(self, row: int) -> tuple[float | None, tuple[str, float] | None]:
        """Return the simulated time of a row, or the observable and its value that state it."""
        moments = [
            (column, self._number(row, place))
            for place, column in enumerate(self._columns)
            if column.kind in ("time", "at") and self._text(row, place)
        ]
        if not moments:
            return None, None
        if len(moments) > 1:
            problem = f"has both '{moments[0][0].title}' and '{moments[1][0].title}'"
            raise DataError(self._where(row), problem, "One of them states when.")
        column, value = moments[0]
        if column.kind == "at":
            return None, (column.name, value)
        start, _ = self._field(row, "start", "start") or (self._start, 0)
        if value < start:
            problem = f"was measured at {value:g} s, before the run begins at {start:g} s"
            raise DataError(self._where(row), problem)
        return value - start, None

    def _condition(self, row: int) -> int:
        """Return the number of a row's condition, which may be a new one."""
        changes: dict[str, Any] = {}
        label = ""
        for place, column in enumerate(self._columns):
            text = self._text(row, place)
            if column.kind == "label":
                label = text
            elif column.kind == "condition":
                if not text:
                    problem = "is empty: each row states all conditions"
                    raise DataError(self._where(row, place), problem)
                changes[column.name] = column.of_scene(text)
        key = tuple(changes.items())
        if key not in self._keys:
            self._keys[key] = len(self._keys)
            self._labels.append(label or self._named(row))
            self._scenes.append(self._changed(row, changes))
        return self._keys[key]

    def _named(self, row: int) -> str:
        """Return the conditions of a row in words."""
        parts = []
        for place, column in enumerate(self._columns):
            if column.kind == "condition":
                name = column.name.removeprefix("nutrients.").removesuffix(".boundary")
                parts.append(f"{name} {self._text(row, place)} {column.unit}".strip())
        return ", ".join(parts)

    def _changed(self, row: int, changes: Mapping[str, Any]) -> Scene:
        """Return the scene of a condition."""
        try:
            scene = self._scene.with_changes(changes)
        except SceneError as error:
            place = next((k for k, c in enumerate(self._columns) if error.path == c.name), None)
            raise DataError(self._where(row, place), error.problem, error.hint) from None
        units = {".".join(path): spec.units for path, _, spec in leaves(scene)}
        for place, column in enumerate(self._columns):
            wanted = units.get(column.name, "") if column.kind == "condition" else ""
            if wanted and not column.unit and not isinstance(changes[column.name], str):
                hint = f"Write '{column.name} / {wanted}'."
                raise DataError(self._where(None, place), "has no unit", hint)
        return scene

    def _lasting(self, condition: int) -> Scene:
        """Return the scene of a condition, as long as its data need."""
        scene = self._scenes[condition]
        own = [d for d in self._data if d.condition == condition]
        times = [d.time for d in own if d.time is not None]
        last = max(times, default=0.0)
        self._refuse_stop(scene, own)
        if len(times) < len(own):
            late = next((d for d in own if (d.time or 0.0) > scene.duration), None)
            if late is None:
                return scene
            raise DataError(
                f"{self._table.name}, {late.place}",
                f"was measured {late.time:g} s after the start, the scene ends at "
                f"{scene.duration:g} s, where other rows of the same condition are taken",
                f"Set the scene's duration, or give all rows a time: '--set duration={last:g}'.",
            )
        if last == 0.0:
            problem = "is of the run's very start, which says nothing of what a run does"
            raise DataError(f"{self._table.name}, {own[-1].place}", problem)
        try:
            return replace(scene, duration=last)
        except SceneError as error:
            place = f"{self._table.name}, {own[times.index(last)].place}"
            raise DataError(place, f"{error.path} {error.problem}", error.hint) from None

    def _refuse_stop(self, scene: Scene, own: Sequence[Datum]) -> None:
        """Refuse data that a run cannot reach because it ends with fewer cells."""
        stop = represented(scene, scene.stop_cells or 0)
        late = next((d for d in own if d.observable == "cells" and stop and d.value > stop), None)
        if late is not None:
            raise DataError(
                f"{self._table.name}, {late.place}",
                f"has {late.value:,.0f} cells, where runs end with {stop:,} (stop_cells)",
                "Set a larger stop_cells, or none: '--set stop_cells='.",
            )

    def _all_units(self) -> dict[str, str]:
        known: dict[str, str] = {}
        for scene in self._scenes:
            known |= in_history(scene) | at_the_end(scene)
        return known

    def _checked_start(self, start: float | str | None) -> float:
        if start is None:
            return 0.0
        if any(column.kind == "start" for column in self._columns):
            raise DataError("start", "is given twice: there is a column 'start' too")
        try:
            return to_base(start, "s", "start")
        except SceneError as error:
            raise DataError("start", error.problem, error.hint) from None

    def _text(self, row: int, place: int) -> str:
        return self._table.rows[row][place]

    def _number(self, row: int, place: int) -> float:
        """Return the number in a field in base units."""
        return self._columns[place].number(self._text(row, place), self._where(row, place))

    def _where(self, row: int | None, place: int | None = None) -> str:
        """Return a row, a column or a field in words."""
        parts = [self._table.name]
        if row is not None:
            parts.append(self._table.places[row])
        if place is not None:
            parts.append(f"'{self._columns[place].title}'")
        return ", ".join(parts)


def _group(data: Sequence[Datum]) -> list[Datum]:
    """Return data in which replicates are one: the mean, with the error of that mean.

    Replicates are weighted by their tissues, or by 1/σ² where σ holds the scatter of tissues.
    """
    groups: dict[tuple[Any, ...], list[Datum]] = {}
    for datum in data:
        means = math.isinf(datum.tissues)
        key = datum.observable, datum.condition, datum.time, datum.at, datum.log, means
        groups.setdefault(key, []).append(datum)
    return [_merge(group) if len(group) > 1 else group[0] for group in groups.values()]


def _merge(group: Sequence[Datum]) -> Datum:
    """Return the mean of replicates."""
    first = group[0]
    weights = [d.sigma**-2 if math.isinf(d.tissues) else d.tissues for d in group]
    pairs = list(zip(weights, group, strict=True))
    mean = sum(w * d.scaled(d.value) for w, d in pairs) / sum(weights)
    error = math.sqrt(sum((w * d.sigma) ** 2 for w, d in pairs)) / sum(weights)
    places = f"{first.place} and {len(group) - 1} more"
    return replace(
        first, value=math.exp(mean) if first.log else mean, sigma=error,
        assumed=any(d.assumed for d in group), place=places,
        tissues=sum(d.tissues for d in group),
    )  # fmt: skip
