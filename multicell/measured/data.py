"""Measured data of runs: a table with units in its header, checked before anything runs.

One row for each measurement, from a CSV file or a pandas ``DataFrame``. The title of a column
states its content, ``NAME / UNIT`` (or ``NAME [UNIT]``)::

    time / h, diameter / um, diameter sd / um, cells, nutrients.oxygen.boundary / mM
    48,       272,           14,               1472,  0.2
    96,       370,           19,               4409,  0.2

=====================  ===========================================================================
``time / h``           when it was measured; empty: at the end of the run. ``day`` is ``time / d``,
                       ``hours`` is ``time / h``
``start / h``          age of the culture, on the clock of ``time``, at which the run begins
an observable          any number of a run's history; of its summary for rows without a time.
                       An empty field was not measured
a field                concentration at a depth, mean over the shell there; oxygen also ``/ mmHg``
``depth / um``         of such a row: below the surface, negative in the medium
``specimen``           name of the specimen of the row (see below)
``diameter sd / um``   error of measuring one tissue, as a standard deviation; ``/ %`` of the value
``diameter n``         how many tissues the value is the mean of: their errors and their scatter
                       over the seeds of runs count as 1/n
``diameter sem / um``  in place of both: the standard error of the mean over tissues, which holds
                       their scatter; ``/ %`` of the value
``sd``, ``n``          of the values to their left, in the same unit; ``sem`` likewise
a key of the scene     the conditions of the row
``label``              name of the row's condition, for pictures
=====================  ===========================================================================

Rows with the same conditions, time and observable are replicates: one datum, their mean, with as
many tissues as there are rows. Tissues of different times are taken to be the same ones: their
scatter is correlated over time as that of runs is. Where others were measured each time, a standard
error of the mean says so, as it counts as independent; or a column ``specimen``: rows of one name
are the same specimen, each row without a name is another one (``specimens="single"``: all are).
Then the scatter of specimens is what the rows show (:mod:`multicell.measured.noise`). The
error of a length of 0, such as a core that has not begun, is the radius of a cell at division where
the table states it as a part of the value or not at all; over the radius of the tissue where it is
a part of that. Lines that begin with ``#`` are remarks. What a datum is compared with, and in
which unit of deviation, is settled here too (:class:`Datum`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final, final

from multicell.errors import DataError, SceneError
from multicell.measured.columns import ERRORS, NUMBER_KINDS, DataColumn, columns_of, depth_fields
from multicell.measured.noise import group
from multicell.measured.observables import at_the_end, in_history, suggest
from multicell.measured.table import read_measurements
from multicell.results.observable import represented
from multicell.scene.scene import Scene
from multicell.scene.sizes import division_radius
from multicell.schema import chosen, leaves
from multicell.tables.columns import Table
from multicell.units import time_text

ASSUMED: Final = 0.1
"""Relative standard deviation of data that come without one, unless another one is given."""

SPECIMENS: Final = ("same", "single")
"""What rows without a name of a specimen are: the same tissues at all times, or one each."""

_OF_RADIUS: Final = ("inhibited_ratio", "necrotic_ratio")
"""Lengths over the radius of the tissue, which are as uncertain as a cell's radius over it."""


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
    - ``time``: simulated time in s; None: at the end
    - ``condition``: number of the condition
    - ``place``: row in the source, in words
    - ``tissues``: how many tissues the value is the mean of; infinite where ``sigma`` holds their
      scatter
    - ``depth``: below the surface in µm, of a field; None for other observables
    - ``specimens``: names of the specimens whose mean it is, each with what it was found to be
      above the mean (on the scale of comparison); empty where no names are known
    """

    observable: str
    value: float
    sigma: float
    log: bool
    assumed: bool
    time: float | None
    condition: int
    place: str
    tissues: float = 1.0
    depth: float | None = None
    specimens: tuple[tuple[str, float], ...] = ()

    @property
    def column(self) -> str:
        """Name in the history of a fit's runs, which have a column for each depth."""
        return self.observable if self.depth is None else f"{self.observable} at {self.depth:g} um"

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
    """Conditions under which some of the data were measured.

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

    @cached_property
    def numbers(self) -> Mapping[int, list[int]]:
        """Places in ``data`` of the data of each condition."""
        found: dict[int, list[int]] = {k: [] for k in range(len(self.conditions))}
        for number, datum in enumerate(self.data):
            found[datum.condition].append(number)
        return found

    def of(self, condition: int) -> list[Datum]:
        """Return the data of one condition."""
        return [self.data[k] for k in self.numbers[condition]]


def read_data(
    source: Any,
    scene: Scene,
    *,
    sd: float = ASSUMED,
    specimens: str = "same",
) -> Measured:
    """Read measured data of a scene.

    - ``source``: path of a CSV file, a pandas ``DataFrame`` with the same titles, or a mapping of
      titles to columns
    - ``scene``: what is fitted. A condition's runs end with its last datum, be that before the
      scene's end or after it; where a row has no time, with the scene.
    - ``sd``: relative standard deviation of data without one
    - ``specimens``: ``"single"``: each row is another specimen, measured once
    """
    if not (isinstance(sd, int | float) and 0.0 < sd < math.inf):
        raise DataError("sd", f"is {sd!r}, must be a relative standard deviation above 0")
    table = read_measurements(source)
    chosen(specimens, SPECIMENS, "specimens")
    columns = columns_of(table, scene)
    rows = _Rows(table, columns, scene, float(sd), single=specimens == "single")
    for number in range(len(table.rows)):
        rows.read(number)
    return rows.measured()


def _key(column: DataColumn) -> tuple[str, str]:
    return column.kind, column.name


@final
class _Rows:
    """Reads the rows of a table one by one."""

    def __init__(
        self,
        table: Table,
        columns: Sequence[DataColumn],
        scene: Scene,
        sd: float,
        *,
        single: bool,
    ) -> None:
        self._table = table
        self._columns = columns
        self._relative = {_key(column) for column in columns if column.relative}
        self._scene = scene
        self._sd = sd
        self._has_specimens = single or any(column.kind == "specimen" for column in columns)
        self._keys: dict[tuple[tuple[str, Any], ...], int] = {}
        self._conditions: list[Condition] = []
        self._data: list[Datum] = []

    def read(self, row: int) -> None:
        """Read one row."""
        condition, numbers = self._condition(row), self._numbers(row)
        time = self._time(row, numbers)
        scene = self._conditions[condition].scene
        fields, timed = depth_fields(scene), in_history(scene)
        known = fields | timed | at_the_end(scene)
        depth = numbers.get(("depth", "depth"))
        texts = zip(self._columns, self._table.rows[row], strict=True)
        names = [text for column, text in texts if column.kind == "specimen" and text]
        name = names[0] if names else self._table.places[row]
        found = 0
        for place, column in enumerate(self._columns):
            if column.kind != "value" or not self._text(row, place):
                continue
            where = self._where(row, place)
            if column.name not in known:
                problem = f"'{column.name}' is no observable of the scene under these conditions"
                raise DataError(where, problem, suggest(column.name, known))
            if (column.name in fields) != (depth is not None):
                problem = "has a depth, and is no field" if depth is not None else "has no depth"
                hint = "A field has a value at a 'depth / um', other observables have none."
                raise DataError(where, problem, hint)
            if column.name not in fields | timed and time is not None:
                problem = f"'{column.name}' is known at the end of a run only"
                raise DataError(where, problem, "Leave the time of this row empty.")
            datum = self._datum(row, column, numbers, where, condition, time)
            alone = ((f"{condition} {name}", 0.0),) if self._has_specimens else ()
            self._data.append(replace(datum, depth=depth, specimens=alone))
            found += 1
        if found == 0:
            raise DataError(self._where(row), "has no measured value")

    def measured(self) -> Measured:
        """Return the data that were read."""
        conditions = tuple(
            replace(one, scene=self._lasting(k, one.scene))
            for k, one in enumerate(self._conditions)
        )
        known: dict[str, str] = {}
        for one in self._conditions:
            known |= depth_fields(one.scene) | in_history(one.scene) | at_the_end(one.scene)
        units = {d.observable: known[d.observable] for d in self._data}
        data = group(self._data, self._table.name)
        return Measured(tuple(data), conditions, units, self._table.name)

    def _numbers(self, row: int) -> dict[tuple[str, str], float]:
        """Return the numbers of a row in base units by kind and name of their columns."""
        fields = list(enumerate(zip(self._columns, self._table.rows[row], strict=True)))
        found = {
            _key(column): column.number(text, self._where(row, place))
            for place, (column, text) in fields
            if text and column.kind in NUMBER_KINDS
        }
        for key, value in [(k, found.get(("value", k[1]))) for k in found if k[0] in ERRORS]:
            column = next(c for c in self._columns if _key(c) == key)
            found[key] = column.error_of(found[key], value or 0.0)
        return found

    def _datum(
        self,
        row: int,
        column: DataColumn,
        numbers: Mapping[tuple[str, str], float],
        where: str,
        condition: int,
        time: float | None,
    ) -> Datum:
        """Return a datum with what it is compared in."""
        value, given, mean, count = (
            numbers.get((kind, column.name)) for kind in ("value", "sd", "sem", "n")
        )
        assert value is not None
        if mean is not None and (given is not None or count is not None):
            problem = f"has both '{column.name} sem' and '{column.name} sd' or '{column.name} n'"
            raise DataError(where, problem, "The error of the mean stands in place of both.")
        if self._has_specimens and (mean is not None or count is not None):
            problem = f"has a '{column.name} sem' or '{column.name} n', and is a single specimen"
            raise DataError(where, problem, "Rows of means have no specimens.")
        tissues = math.inf if mean is not None else count or 1.0
        kind = "sd" if mean is None else "sem"
        given = mean if given is None else given
        relative = given if (kind, column.name) in self._relative else None
        if given is None:
            relative = self._sd
        log = column.name == "cells" and relative is not None
        if relative is not None and value == 0.0:
            size = 1.0 if column.base == "um" else None
            if column.name in _OF_RADIUS:  # a part of the radius
                diameter = numbers.get(("value", "diameter"), 0.0)
                size = numbers.get(("value", "radius")) or 0.5 * diameter or None
            if log or size is None:
                raise DataError(
                    where,
                    "is 0, of which a relative standard deviation says nothing",
                    f"Add a column '{column.name} sd' with its unit.",
                )
            sigma = division_radius(self._conditions[condition].scene) / size
        elif relative is None:
            assert given is not None
            sigma = given
        else:
            sigma = relative if log else relative * abs(value)
        return Datum(
            column.name,
            value,
            sigma / math.sqrt(count or 1.0),
            log,
            given is None,
            time,
            condition,
            self._table.places[row],
            tissues,
        )

    def _time(self, row: int, numbers: Mapping[tuple[str, str], float]) -> float | None:
        """Return the simulated time of a row; None: at the end."""
        time = numbers.get(("time", "time"))
        if time is None:
            return None
        start = numbers.get(("start", "start"), 0.0)
        if time < start:
            problem = f"was measured {time_text(start - time)} before the run begins"
            raise DataError(self._where(row), problem)
        return time - start

    def _condition(self, row: int) -> int:
        """Return the number of a row's condition, which may be a new one."""
        changes: dict[str, Any] = {}
        label, words = "", []
        for place, column in enumerate(self._columns):
            text = self._text(row, place)
            if column.kind == "label":
                label = text
            elif column.kind == "condition":
                if not text:
                    problem = "is empty: each row states all conditions"
                    raise DataError(self._where(row, place), problem)
                changes[column.name] = column.of_scene(text)
                name = column.name.removeprefix("nutrients.").removesuffix(".boundary")
                words.append(f"{name} {text} {column.unit}".strip())
        number = self._keys.setdefault(tuple(changes.items()), len(self._keys))
        if number == len(self._conditions):
            label = label or ", ".join(words) or f"condition {number + 1}"
            self._conditions.append(Condition(label, changes, self._changed(row, changes)))
        return number

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

    def _lasting(self, condition: int, scene: Scene) -> Scene:
        """Return the scene of a condition, as long as its data need."""
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
            problem = "is of the run's very start, before anything happens in a run"
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

    def _text(self, row: int, place: int) -> str:
        return self._table.rows[row][place]

    def _where(self, row: int | None, place: int | None = None) -> str:
        """Return a row, a column or a field in words."""
        parts = [self._table.name]
        if row is not None:
            parts.append(self._table.places[row])
        if place is not None:
            parts.append(f"'{self._columns[place].title}'")
        return ", ".join(parts)
