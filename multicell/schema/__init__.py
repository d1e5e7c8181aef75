"""Parts of a scene as frozen dataclasses whose fields convert and check what they are given.

A part is declared once and the declaration says everything: unit, default, what is allowed::

    @final
    @parameters
    class Drag:
        viscosity: float = quantity("kPa s", default=5.0, above=0, doc="of the medium")

``Drag(viscosity="70 Pa s").viscosity`` is 0.07, and ``Drag(viscosity=0)`` raises
:class:`~multicell.errors.SceneError` with the value and what is allowed. A part may define
``check(self)`` for what concerns more than one field.
"""

from multicell.schema.bounds import Bounds
from multicell.schema.declarations import (
    Draw,
    choice,
    count,
    course,
    drawn_numbers,
    file_path,
    flag,
    interval,
    measure,
    measure_points,
    moments,
    names,
    number,
    parameters,
    quantities,
    quantity,
    schedule,
    table,
    tables,
    text,
    texts,
    variant,
    vector,
    whole_numbers,
)
from multicell.schema.part import (
    Parameter,
    Tables,
    build_part,
    chosen,
    leaves,
    near_miss,
    part_as_dict,
    place_of_key,
    separated,
    specs,
)

__all__ = [
    "Bounds",
    "Draw",
    "Parameter",
    "Tables",
    "build_part",
    "choice",
    "chosen",
    "count",
    "course",
    "drawn_numbers",
    "file_path",
    "flag",
    "interval",
    "leaves",
    "measure",
    "measure_points",
    "moments",
    "names",
    "near_miss",
    "number",
    "parameters",
    "part_as_dict",
    "place_of_key",
    "quantities",
    "quantity",
    "schedule",
    "separated",
    "specs",
    "table",
    "tables",
    "text",
    "texts",
    "variant",
    "vector",
    "whole_numbers",
]
