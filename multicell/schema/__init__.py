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

from multicell.schema.bounds import Bounds as Bounds
from multicell.schema.declarations import Draw as Draw
from multicell.schema.declarations import choice as choice
from multicell.schema.declarations import count as count
from multicell.schema.declarations import course as course
from multicell.schema.declarations import drawn_numbers as drawn_numbers
from multicell.schema.declarations import file_path as file_path
from multicell.schema.declarations import flag as flag
from multicell.schema.declarations import interval as interval
from multicell.schema.declarations import measure as measure
from multicell.schema.declarations import measure_points as measure_points
from multicell.schema.declarations import moments as moments
from multicell.schema.declarations import names as names
from multicell.schema.declarations import number as number
from multicell.schema.declarations import parameters as parameters
from multicell.schema.declarations import quantities as quantities
from multicell.schema.declarations import quantity as quantity
from multicell.schema.declarations import schedule as schedule
from multicell.schema.declarations import table as table
from multicell.schema.declarations import tables as tables
from multicell.schema.declarations import text as text
from multicell.schema.declarations import texts as texts
from multicell.schema.declarations import variant as variant
from multicell.schema.declarations import vector as vector
from multicell.schema.declarations import whole_numbers as whole_numbers
from multicell.schema.part import Parameter as Parameter
from multicell.schema.part import Tables as Tables
from multicell.schema.part import below as below
from multicell.schema.part import build_part as build_part
from multicell.schema.part import chosen as chosen
from multicell.schema.part import leaves as leaves
from multicell.schema.part import near_miss as near_miss
from multicell.schema.part import part_as_dict as part_as_dict
from multicell.schema.part import place_of_key as place_of_key
from multicell.schema.part import separated as separated
from multicell.schema.part import specs as specs
