"""Columns of ``rows``, (n, 5) or (n, 7): data of each cell for kernels, contiguous in memory.

The first three are the position, µm, by axis: ``rows[:, 0]`` to ``rows[:, 2]``.
"""

from typing import Final

RADIUS: Final = 3  # µm
COMPLIANCE: Final = 4  # 1/kPa, of multicell.contact.law.compliance
RECEPTOR: Final = 5  # adhesion molecules of a cell, where cells have any
LIGAND: Final = 6  # the same

SHORTEST: Final = 1e-300
"""Square that is added to that of a distance, µm²: coincident centres keep a finite distance, and
their direction, and so their force, is zero."""

SOFTENING: Final = 0.5
"""Newton's matrix shows no dF/dh below minus this times E_ij r_ij (JKR's slope tends to -∞ at first
contact). It leaves the solution as it is."""
