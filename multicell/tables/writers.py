"""Tables of cells as other programs write them: recognised by their titles."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final, NamedTuple, final

from multicell.errors import DataError
from multicell.tables.mapping import ColumnMap, column_source, like

UNITS_BELOW: Final = ("LABEL", "POSITION_X")
"""Titles of a table whose names and units stand in further lines below the titles."""


@final
class Writer(NamedTuple):
    """A program that writes tables of cells.

    - ``name``: of the program and its table
    - ``marks``: titles that all its tables have
    - ``columns``: what they are, name -> texts as of ``--columns``, of which the first holds whose
      title is there. ``{unit}`` stands for the unit that the table states.
    - ``units``: title of the column that holds the unit, or of the one below whose title it stands
    """

    name: str
    marks: tuple[str, ...]
    columns: dict[str, tuple[str, ...]]
    units: str = ""


def _axes(*titles: str, unit: str = "pixel") -> dict[str, tuple[str, ...]]:
    """Return the columns of x, y and z."""
    along = "slice" if unit == "pixel" else unit
    return {
        axis: (f'"{title}" {along if axis == "z" else unit}',)
        for axis, title in zip("xyz", titles, strict=False)
    }


WRITERS: Final = (
    Writer(
        "TrackMate spots",
        ("TRACK_ID", "POSITION_X", "POSITION_Y", "FRAME"),
        {
            "x": ("POSITION_X {unit}",),
            "y": ("POSITION_Y {unit}",),
            "z": ("POSITION_Z {unit}",),
            "radius": ("RADIUS {unit}",),
            "frame": ("FRAME",),
            "time": ("POSITION_T s",),
        },
        units="POSITION_X",
    ),
    Writer(
        "positions of Imaris",
        ("Position X", "Position Y", "Position Z", "Unit"),
        _axes("Position X", "Position Y", "Position Z", unit="{unit}") | {"frame": ("Time",)},
        units="Unit",
    ),
    *(
        Writer(
            "objects of CellProfiler",
            ("ImageNumber", "ObjectNumber", f"{of}_Center_X"),
            _axes(f"{of}_Center_X", f"{of}_Center_Y", f"{of}_Center_Z")
            | {
                "radius": ("AreaShape_Volume pixel^3", "AreaShape_Area pixel^2"),
                "frame": ("ImageNumber",),
            },
        )
        for of in ("Location", "AreaShape")
    ),
    Writer(
        "regions of scikit-image (Cellpose, StarDist)",
        ("centroid-0", "centroid-1", "centroid-2"),
        _axes("centroid-2", "centroid-1", "centroid-0") | {"radius": ("area pixel^3",)},
    ),
    Writer(
        "regions of scikit-image (Cellpose, StarDist)",
        ("centroid-0", "centroid-1"),
        _axes("centroid-1", "centroid-0") | {"radius": ("area pixel^2",)},
    ),
    Writer(
        "detections of QuPath",
        ("Centroid X µm", "Centroid Y µm"),
        _axes("Centroid X µm", "Centroid Y µm", unit="um")
        | {
            "radius": (
                '"Cell: Area µm^2" um^2',
                '"Cell: Area" um^2',
                '"Nucleus: Area µm^2" um^2',
                '"Nucleus: Area" um^2',
                '"Area µm^2" um^2',
            ),
            "type": ("Classification", "Class"),
        },
    ),
    Writer(
        "the 3D Objects Counter of ImageJ",
        ("Nb of obj. voxels", "X", "Y", "Z"),
        _axes("X", "Y", "Z") | {"radius": ('"Nb of obj. voxels" pixel^3',)},
    ),
    Writer(
        "MorphoLibJ's regions",
        ("Label", "Volume", "Centroid.X", "Centroid.Y", "Centroid.Z"),
        _axes("Centroid.X", "Centroid.Y", "Centroid.Z") | {"radius": ("Volume pixel^3",)},
    ),
    Writer(
        "measurements of ImageJ",
        ("Area", "Mean", "X", "Y"),
        _axes("X", "Y") | {"radius": ("Area pixel^2",), "frame": ("Frame",)},
    ),
    Writer(
        "measurements of ImageJ",
        ("Area", "Mean", "XM", "YM"),
        _axes("XM", "YM") | {"radius": ("Area pixel^2",), "frame": ("Frame",)},
    ),
    Writer(
        "objects of ilastik",
        ("Center_of_the_object_0", "Center_of_the_object_1"),
        _axes("Center_of_the_object_0", "Center_of_the_object_1", "Center_of_the_object_2")
        | {"type": ("Predicted_Class", '"Predicted Class"'), "frame": ("timestep", "frame")},
    ),
    Writer(
        "points of napari",
        ("index", "axis-0", "axis-1", "axis-2"),
        _axes("axis-2", "axis-1", "axis-0"),
    ),
    Writer("points of napari", ("index", "axis-0", "axis-1"), _axes("axis-1", "axis-0")),
    Writer(
        "cells of PhysiCell",
        ("x", "y", "z", "type"),
        _axes("x", "y", "z", unit="um") | {"radius": ("volume um^3",), "type": ("type",)},
    ),
)
"""After the documentation and the files of each program; the first that fits is taken."""


def writer_of(titles: Sequence[str]) -> Writer | None:
    """Return the program that writes tables with such titles, None if none is known."""
    there = {like(title) for title in titles}
    return next((w for w in WRITERS if all(like(mark) in there for mark in w.marks)), None)


def map_of(
    writer: Writer, titles: Sequence[str], unit: str, settings: ColumnMap, table: str
) -> ColumnMap:
    """Return the names of the columns of a program's table.

    - ``unit``: of lengths, that the table states; empty: none
    - ``settings``: what the user says of the whole table
    """
    found = dict(settings.entries)
    for name, texts in writer.columns.items():
        for text in texts:
            text = text.format(unit=unit or "pixel")
            try:
                column_source(name, text, titles, table)
            except DataError:
                continue  # a column that this table does not have
            found[name] = text
            break
    return ColumnMap(found)


def unit_word(text: str) -> str:
    """Return a unit as a program writes it, in multicell's words; ``pixel`` for all kinds."""
    word = text.strip().strip("()[]").strip()
    return "pixel" if re.fullmatch(r"(?i)pixels?|px|voxels?", word) else word
