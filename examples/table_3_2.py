"""Equilibrium distance of two equal cells against their radius and kind: a table
==============================================================================

Problem
    Two equal cells adhere and are in equilibrium where the JKR force is zero. Kinds of cells: the
    thesis's set (E = 1 kPa, Poisson ratio 0.5), the set of Drasdo and Hoehme for spheroids
    (E = 0.45 kPa, 0.4) and sarcoma S180 by Chu et al. 2005 (E = 3.5 kPa, 0.5 assumed). All
    with the thesis's surface energy of 0.1 nN/um, which was not measured for each kind.
Scaling
    The relative overlap h / 2r falls like r^(-2/3): small cells overlap more. The
    equilibrium overlap of exact JKR is a third of that of the approximate law.
Cost
    Less than a second.
Command
    .. code-block:: sh

        python examples/table_3_2.py [FOLDER]

    It prints, and writes FOLDER/table_3_2.csv.
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import final

from multicell.contact.exact_jkr import ExactJKR
from multicell.contact.jkr import JKR
from multicell.contact.law import effective_modulus, effective_radius

KINDS = {"thesis": (1.0, 0.5), "Drasdo-Hoehme": (0.45, 0.4), "S180": (3.5, 0.5)}
"""Young's modulus (kPa) and Poisson ratio by kind of cell."""
RADII = (3.0, 4.0, 4.5, 5.0, 6.0, 7.5, 10.0, 12.5, 15.0)
"""Radii, um. A spheroid's cell is born with about 4.0 to 4.5 um and divides at 5 um."""


@final
@dataclass(frozen=True)
class Row:
    """One line of the table; the names state the units."""

    kind: str
    young_kPa: float  # noqa: N815 - kPa is written so
    poisson: float
    surface_energy_nN_per_um: float  # noqa: N815
    radius_um: float
    overlap_um: float
    distance_um: float
    distance_over_diameter: float
    exact_jkr_distance_um: float


def setup(
    radii: Iterable[float] = RADII, kinds: Iterable[str] = tuple(KINDS), surface_energy: float = 0.1
) -> list[Row]:
    """Return the rows for given radii (um), kinds and surface energy (nN/um)."""
    return [row(kind, radius, surface_energy) for kind in kinds for radius in radii]


def row(kind: str, radius: float, surface_energy: float) -> Row:
    """Return the row of one kind and radius."""
    young, poisson = KINDS[kind]
    pair = effective_modulus(young, poisson, young, poisson), effective_radius(radius, radius)
    overlap = float(JKR(surface_energy=surface_energy).equilibrium_overlap(*pair))
    exact = float(ExactJKR(surface_energy=surface_energy).equilibrium_overlap(*pair))
    distance = 2.0 * radius - overlap
    return Row(
        kind,
        young,
        poisson,
        surface_energy,
        radius,
        overlap,
        distance,
        distance / (2.0 * radius),
        2.0 * radius - exact,
    )


def text(rows: list[Row]) -> str:
    """Return the table for reading: a line for each radius, a column for each kind."""
    kinds = list(dict.fromkeys(r.kind for r in rows))
    lines = ["Equilibrium distance in um (share of the diameter)", ""]
    lines.append("radius (um)" + "".join(f"{kind:>20s}" for kind in kinds))
    for radius in dict.fromkeys(r.radius_um for r in rows):
        cells = {r.kind: r for r in rows if r.radius_um == radius}
        entries = (
            f"{cells[k].distance_um:11.3f} ({cells[k].distance_over_diameter:6.1%})" for k in kinds
        )
        lines.append(f"{radius:11.1f}" + "".join(entries))
    return "\n".join(lines)


def main(output: str | Path) -> list[Row]:
    """Write the table as CSV and return its rows."""
    rows, folder = setup(), Path(output)
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "table_3_2.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(asdict(rows[0])))
        writer.writeheader()
        writer.writerows(asdict(entry) for entry in rows)
    return rows


if __name__ == "__main__":
    print(text(main(*(sys.argv[1:2] or ["out/table_3_2"]))))
