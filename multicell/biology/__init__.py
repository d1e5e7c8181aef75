"""What cells do by themselves: start, grow, change phase, divide, die."""

from multicell.biology.cycle import Cycling, advance, leave_rest, parting, phase_counts
from multicell.biology.death import remove_lysed
from multicell.biology.division import divide
from multicell.biology.growth import birth_volume, division_volume, growth_factor, volumes_after
from multicell.biology.initial import initial_cells
from multicell.biology.motility import push
from multicell.biology.phases import deciding, restricted, unfavourable, update_states

__all__ = [
    "Cycling",
    "advance",
    "birth_volume",
    "deciding",
    "divide",
    "division_volume",
    "growth_factor",
    "initial_cells",
    "leave_rest",
    "parting",
    "phase_counts",
    "push",
    "remove_lysed",
    "restricted",
    "unfavourable",
    "update_states",
    "volumes_after",
]
