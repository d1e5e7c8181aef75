"""What cells do by themselves: start, grow, change phase, divide, die."""

from multicell.biology.death import remove_lysed
from multicell.biology.division import divide
from multicell.biology.growth import birth_volume, division_volume, growth_factor, volumes_after
from multicell.biology.initial import initial_cells
from multicell.biology.motility import push
from multicell.biology.phases import update_states

__all__ = [
    "birth_volume",
    "divide",
    "division_volume",
    "growth_factor",
    "initial_cells",
    "push",
    "remove_lysed",
    "update_states",
    "volumes_after",
]
