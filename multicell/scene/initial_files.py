"""Files that fields begin as: part of a scene, known by the digest of their bytes."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Final, final

from multicell.errors import DataError, SceneError
from multicell.host.files import other_file
from multicell.schema import file_path, interval, parameters, quantity, text

if TYPE_CHECKING:
    from multicell.tables.grids import GridValues

Corners = tuple[tuple[float, float, float], tuple[float, float, float]]
"""Lower and upper corner of a box, µm, infinite along an axis without ends."""

_MOST: Final = 1e5  # mM: more than pure water, 55,500 mM
_MAX_BYTES: Final = 2_000_000_000  # of text for as many values as the largest grid has


@final
@parameters
class InitialFile:
    """Concentrations on a regular grid that a transient field starts from.

    They lie at the centres of equal boxes between the ends of the grid. Outside is the medium.
    """

    file: str = file_path(
        doc="NumPy array (.npy), image of grey values (TIFF, PNG), or CSV with columns x, y, z in "
        "um and of the field; relative paths count from the folder of the scene"
    )
    sha256: str | None = text(default=None, doc="digest of the file; absent: that which it has")
    scale: float = quantity(
        "mM", default=1.0, above=0, at_most=_MOST, doc="concentration where the file has 1"
    )
    column: str = text(default="", doc="title of the values in a CSV; absent: the field's name")
    x: tuple[float, float] | None = interval(
        "um", doc="ends of the grid along x; absent: those of the domain, or of a CSV's places"
    )
    y: tuple[float, float] | None = interval("um", doc="ends of the grid along y")
    z: tuple[float, float] | None = interval("um", doc="ends of the grid along z")

    def check(self) -> None:
        """Raise ``SceneError`` for a file that is not there, or not the one that is meant."""
        if not self.file:
            raise SceneError("file", "is empty, must be the path of a file")
        digest = hashlib.sha256(_content(self.file)).hexdigest()
        if self.sha256 not in (None, digest):
            raise other_file(self.file)
        object.__setattr__(self, "sha256", digest)

    def content(self) -> bytes:
        """Return the bytes of the file; raises ``SceneError`` where their digest is another one."""
        content = _content(self.file)
        if hashlib.sha256(content).hexdigest() != self.sha256:
            raise other_file(self.file)
        return content

    def grid(self, name: str) -> GridValues:
        """Return the values of the file for a field of this name, in its own unit."""
        assert self.sha256 is not None
        return _grid(_Known(self, self.sha256, self.column or name))

    def ends(
        self, own: tuple[tuple[float, float], ...] | None, dimensions: int, box: Corners | None
    ) -> tuple[tuple[float, float], ...]:
        """Return the lower and the upper end of the grid along each axis, µm.

        - ``own``: those that the file has
        - ``box``: corners of the domain

        Raises ``SceneError`` where nothing states them, or two things do.
        """
        found = []
        for k, axis in enumerate("xyz"[:dimensions]):
            stated = getattr(self, axis)
            if stated is not None and own is not None:
                problem = "has no meaning: the file states its places"
                raise SceneError(axis, problem, "Leave it out.")
            ends = stated if own is None else own[k]
            if ends is None and box is not None and math.isfinite(box[0][k]):
                ends = box[0][k], box[1][k]
            if ends is None:
                hint = f"For example {axis} = ['-100 um', '100 um'], between which its values lie."
                raise SceneError(axis, "is missing: the scene has no domain", hint)
            found.append(ends)
        return tuple(found)


@final
@dataclass(frozen=True)
class _Known:
    """A file by its content: wherever it lies, its values are the same."""

    part: InitialFile = field(compare=False)
    digest: str
    column: str


@lru_cache(maxsize=8)
def _grid(known: _Known) -> GridValues:
    from multicell.tables.grids import grid_values

    part = known.part
    try:
        found = grid_values(part.content(), Path(part.file).name, known.column)
    except DataError as error:
        raise SceneError("file", f"{error.place} {error.problem}", error.hint) from None
    found.values.flags.writeable = False
    return found


def _content(path: str) -> bytes:
    from multicell.tables.text import read_bytes

    try:
        return read_bytes(Path(path), _MAX_BYTES)
    except DataError as error:
        hint = "Relative paths count from the folder of the scene file."
        raise SceneError("file", f"'{path}' {error.problem}", hint) from None
