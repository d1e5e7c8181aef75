"""Frames without what follows from other parts of the file, and back, to the bit."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Protocol, final

import numpy as np
from numpy.typing import NDArray

from multicell.cells import Cells, FloatArray, IntArray
from multicell.results.coding import decode, encode
from multicell.results.following import interpolated
from multicell.results.keeping import KEPT, POOLS, Keeper, Pool, differ
from multicell.results.records import FIELD, Arrays

_PLAIN = tuple(name for name in Cells.schema() if name not in KEPT)


@final
class Condenser:
    """Makes of frames, given one after another, what the data sets of a file take of them."""

    def __init__(self, nutrients: Iterable[str]) -> None:
        self._nutrients = tuple(nutrients)
        self._keeper = Keeper()

    def condensed(self, arrays: Mapping[str, NDArray[Any]]) -> Arrays:
        """Return the rows of a frame by data set; of those with one row a frame, that row."""
        kept = {name: arrays[f"cells/{name}"] for name in KEPT}
        entries = self._keeper.entries(float(arrays["time"]), arrays["cells/id"], kept)
        found: Arrays = {
            "frames/time": arrays["time"],
            "frames/step": arrays["step"],
            "contacts/pair": arrays["contacts/pair"],
            "progress/text": arrays["progress/text"],
            **{f"cells/{name}": arrays[f"cells/{name}"] for name in _PLAIN},
            **{f"kept/{path}": rows for path, rows in entries.items()},
        }
        for name in self._nutrients:
            found |= _field(name, arrays)
            expected = _expected(name, arrays)
            actual = arrays[f"cells/concentration_{name}"]
            rows = np.flatnonzero(differ(expected, actual))
            found[f"concentrations/{name}/row"] = rows
            found[f"concentrations/{name}/value"] = actual[rows]
        return found


def _field(name: str, arrays: Mapping[str, NDArray[Any]]) -> Arrays:
    """Return the data sets of a field, also of one that is not there."""
    group = f"fields/{name}"
    values: FloatArray = arrays.get(f"{group}/values", np.empty((0, 0, 0)))
    coded, faces = encode(values)
    found: Arrays = {
        f"{group}/coded": coded.reshape(-1),
        f"{group}/shape": np.array(values.shape),
        f"{group}/faces": faces,
    }
    for key, entry in FIELD.items():
        absent = np.full((entry.width,) if entry.width else (), entry.absent)
        found[f"{group}/{key}"] = arrays.get(f"{group}/{key}", absent)
    return found


def _expected(name: str, arrays: Mapping[str, NDArray[Any]]) -> FloatArray:
    """Return what cells find of a nutrient by its field; NaN without one."""
    group = f"fields/{name}"
    position = arrays["cells/position"]
    if f"{group}/values" not in arrays:
        return np.full(len(position), np.nan)
    return interpolated(
        position,
        arrays[f"{group}/values"],
        arrays[f"{group}/origin"],
        float(arrays[f"{group}/spacing"]),
        radial=bool(arrays[f"{group}/radial"]),
        flat=float(arrays[f"{group}/height"]) > 0.0,
    )


class Source(Protocol):
    """A file that is open."""

    def __getitem__(self, path: str) -> Any:
        """Return a data set."""


@final
class Expander:
    """Makes frames again of the data sets of a file.

    Parameters
    ----------
    nutrients
    ends : data set of offsets -> (k + 1,) int64
    times, steps : (k,)
    """

    def __init__(
        self,
        nutrients: Sequence[str],
        ends: Mapping[str, IntArray],
        times: FloatArray,
        steps: IntArray,
    ) -> None:
        self._nutrients, self._ends = nutrients, ends
        self._times, self._steps = times, steps
        self._pools: dict[str, Pool] = {}

    def expanded(self, file: Source, place: int) -> Arrays:
        """Return the arrays of a frame, in the order in which a journal has them.

        Raises
        ------
        ValueError, IndexError, KeyError
            If the data sets contradict each other.
        """
        columns: Arrays = {}
        for name in _PLAIN:
            columns[name] = self._rows(file, f"cells/{name}", "frames/offset", place)
        for pool in POOLS:
            columns |= self._pool(file, pool).at(place, columns["id"])
        arrays = {"time": np.array(self._times[place]), "step": np.array(self._steps[place])}
        arrays |= {f"cells/{name}": columns[name] for name in Cells.schema()}
        fields: Arrays = {}
        for name in self._nutrients:
            fields |= self._field(file, name, place)
        for name in self._nutrients:
            expected = _expected(name, {**fields, "cells/position": columns["position"]})
            arrays[f"cells/concentration_{name}"] = self._found(file, name, place, expected)
        arrays |= fields
        arrays["contacts/pair"] = self._rows(file, "contacts/pair", "contacts/offset", place)
        arrays["progress/text"] = self._rows(file, "progress/text", "progress/offset", place)
        return arrays

    def _rows(self, file: Source, path: str, pool: str, place: int) -> NDArray[Any]:
        first, last = self._ends[pool][place : place + 2]
        return np.asarray(file[path][int(first) : int(last)])

    def _pool(self, file: Source, name: str) -> Pool:
        if name not in self._pools:
            group = f"kept/{name}"
            columns = {column: file[f"{group}/{column}"][()] for column in POOLS[name]}
            ends = self._ends[f"{group}/offset"]
            self._pools[name] = Pool(file[f"{group}/id"][()], ends, self._times, columns)
        return self._pools[name]

    def _field(self, file: Source, name: str, place: int) -> Arrays:
        group = f"fields/{name}"
        coded = self._rows(file, f"{group}/coded", f"{group}/offset", place)
        if not len(coded):
            return {}
        shape = file[f"{group}/shape"][place]
        values = decode(coded.reshape(shape), file[f"{group}/faces"][place])
        rest = {f"{group}/{key}": np.array(file[f"{group}/{key}"][place]) for key in FIELD}
        return {f"{group}/values": values, **rest}

    def _found(self, file: Source, name: str, place: int, expected: FloatArray) -> FloatArray:
        group = f"concentrations/{name}"
        rows = self._rows(file, f"{group}/row", f"{group}/offset", place)
        expected[rows] = self._rows(file, f"{group}/value", f"{group}/offset", place)
        return expected
