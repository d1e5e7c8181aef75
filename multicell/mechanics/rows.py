"""Columns of ``rows``, (n, 5) or (n, 7): what kernels read of each cell in one run of memory.

The first three are the position, µm, by axis: ``rows[:, 0]`` to ``rows[:, 2]``.
"""

from typing import Final

RADIUS: Final = 3  # µm
COMPLIANCE: Final = 4  # 1/kPa, of multicell.contact.law.compliance
RECEPTOR: Final = 5  # adhesion molecules of a cell, where cells have any
LIGAND: Final = 6
