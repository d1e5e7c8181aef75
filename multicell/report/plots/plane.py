"""Planes that cut a frame: turned so that what is drawn is always a plane across z."""

from __future__ import annotations

import re
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, final

import numpy as np

from multicell.errors import OutputError

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.results.frame import Frame

AXES: Final = ("x", "y", "z")
_TEXT: Final = re.compile(r"([xyz])(?:=(.+))?")


@final
@dataclass(frozen=True)
class Plane:
    """A plane across an axis.

    - ``axis``: ``"x"``, ``"y"`` or ``"z"``
    - ``at``, float or None, µm: where on it; None for the centre of the cells
    """

    axis: str = "z"
    at: float | None = None

    @classmethod
    def parse(cls, text: str) -> Plane:
        """Return the plane that a text such as ``"x"``, ``"x=0"`` or ``"z=12 um"`` names."""
        from multicell.errors import SceneError
        from multicell.units import to_base

        match = _TEXT.fullmatch(text.strip())
        if match is None:
            raise OutputError(f"{text!r} is no plane: write x, y or z, or for example z='12 um'")
        if match[2] is None:
            return cls(match[1])
        with suppress(ValueError):
            return cls(match[1], float(match[2]))
        try:
            return cls(match[1], to_base(match[2], "um", text))
        except SceneError as error:
            raise OutputError(f"{text!r} is no plane: {error.problem}") from None

    @property
    def shown(self) -> tuple[str, str]:
        """The two axes that lie in it, to the right and upwards."""
        x, y, _ = _ORDERS[self.axis]
        return AXES[x], AXES[y]


_ORDERS: Final = {"x": (1, 2, 0), "y": (2, 0, 1), "z": (0, 1, 2)}


def turn_frame(frame: Frame, plane: Plane) -> Frame:
    """Return a frame with its axes in another order, so that the plane lies across the third.

    The order is cyclic: nothing is mirrored.
    """
    if plane.axis == "z":
        return frame
    order = list(_ORDERS[plane.axis])
    cells = frame.cells.shared()
    cells.position = np.ascontiguousarray(frame.cells.position[:, order])
    fields = {}
    for name, field in frame.fields.items():
        values = field.values if field.kind == "radial" else field.values.transpose(order)
        fields[name] = replace(field, origin=field.origin[order], values=values)
    return replace(frame, cells=cells, fields=fields)


def height(frame: Frame, plane: Plane, middle: FloatArray) -> float:
    """Return where the plane cuts a frame that was turned, µm on its third axis."""
    if plane.at is None:
        return float(middle[2])
    place, radius = frame.cells.position[:, 2], frame.cells.radius
    low, high = float((place - radius).min()), float((place + radius).max())
    if not (np.abs(place - plane.at) < radius).any():
        raise OutputError(
            f"the plane {plane.axis} = {plane.at:g} um cuts no cell: they lie between "
            f"{low:.4g} and {high:.4g} um"
        )
    return plane.at
