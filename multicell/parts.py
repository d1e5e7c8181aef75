"""The parts of a scene: frozen dataclasses whose declarations are the keys of the TOML file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import final

import numpy as np

from multicell.errors import SceneError
from multicell.integrators.names import METHODS
from multicell.parameters import (
    choice,
    count,
    course,
    flag,
    number,
    parameters,
    quantities,
    quantity,
)


@final
@parameters
class Initial:
    """The cells at the start."""

    count: int = count(default=1, at_least=1, doc="number of cells")
    arrangement: str = choice(
        ["ball"], default="ball", doc="hexagonal close packing that is cut to a ball"
    )
    spacing: float = number(default=1.0, above=0, doc="centre distance / mean diameter")
    jitter: float = number(
        default=0.0, at_least=0, doc="standard deviation of a random shift / mean diameter"
    )
    stage: str = choice(
        ["birth", "uniform"],
        default="birth",
        doc="volumes: all as at birth, or spread uniformly between birth and division",
    )


@final
@parameters
class CellParameters:
    """Size and elasticity of the cells."""

    division_radius: float = quantity("um", default=5.0, above=0, doc="at which a cell divides")
    young: float = quantity("kPa", default=1.0, above=0, doc="mean Young's modulus")
    young_variation: float = number(
        default=0.1, at_least=0, at_most=0.5, doc="coefficient of variation of Young's modulus"
    )
    poisson: float = number(
        default=0.5,
        above=-1,
        below=1,
        doc="Poisson ratio, at most 0.5 for a solid",
        hint="No isotropic solid has a Poisson ratio above 0.5.",
    )
    allow_unphysical_poisson: bool = flag(
        default=False, doc="permit a Poisson ratio above 0.5, as figure 3.4 of the thesis has it"
    )
    reaction_time: float = quantity(
        "s",
        default=7200.0,
        above=0,
        doc="between two decisions of a cell to rest or to proliferate (assumed, not measured)",
    )

    def check(self) -> None:
        """Raise ``SceneError`` for a Poisson ratio that no solid has, unless it is permitted."""
        if self.poisson > 0.5 and not self.allow_unphysical_poisson:
            problem = f"is {self.poisson:g}, must be above -1 and at most 0.5"
            hint = (
                "No isotropic solid has a Poisson ratio outside this range; "
                "cells.allow_unphysical_poisson = true permits it all the same."
            )
            raise SceneError("poisson", problem, hint)


@final
@parameters
class Drag:
    """Stokes drag 6πηr of the medium on every cell."""

    viscosity: float = quantity(
        "kPa s",
        default=5.0,
        above=0,
        doc="viscosity η of the medium",
        hint="Motion is overdamped: without drag no velocity is defined.",
    )


@final
@parameters
class Growth:
    """Growth and division: the volume doubles, linearly in time, in one cycle."""

    cycle_time: float = quantity("s", default=54000.0, above=0, doc="mean shortest cycle time")
    cycle_variation: float = number(
        default=0.1, at_least=0, at_most=0.5, doc="coefficient of variation of the cycle time"
    )
    critical_pressure: float | None = quantity(
        "kPa", default=None, above=0, doc="at which growth stops; absent: pressure has no effect"
    )


@final
@parameters
class Death:
    """Loss of necrotic cells: their volume decays exponentially, then they are removed."""

    lysis_time: float = quantity("s", default=172800.0, above=0, doc="mean time of the decay")
    removal_fraction: float = number(
        default=0.1, above=0, below=1, doc="of the birth volume, below which a cell is removed"
    )


@final
@parameters
class IntegratorOptions:
    """How the equations of motion are integrated."""

    method: str = choice(METHODS, default="cvode", doc="name of the method")
    rtol: float = number(default=1e-6, at_least=1e-14, at_most=0.1, doc="relative tolerance")
    atol: float = quantity("um", default=0.01, above=0, doc="absolute tolerance")
    max_steps: int = count(default=10000, at_least=1, doc="most steps in one coupling step")
    step: float = quantity("s", default=10.0, above=0, doc="step of the methods with a fixed step")
    max_displacement: float = number(
        default=0.5, above=0, at_most=1, doc="largest move in one step / radius of the cell"
    )


@final
@parameters
class OutputOptions:
    """What is recorded."""

    every: float = quantity("s", default=21600.0, above=0, doc="simulated time between frames")


@final
@parameters
class CellType:
    """Cells that differ from others in stiffness or adhesion.

    ``receptor`` and ``ligand`` are numbers, or lists of ``[time, value]`` between which they
    change linearly; before the first and after the last time they are constant.
    """

    fraction: float = number(default=1.0, at_least=0, doc="share of the cells at the start")
    young: float | None = quantity(
        "kPa", default=None, above=0, doc="mean Young's modulus; absent: that of cells.young"
    )
    surface_energy: Mapping[str, float] | None = quantities(
        "nN/um", at_least=0, doc="of contacts with each type, by name; absent: the law's"
    )
    receptor: tuple[tuple[float, float], ...] = course(
        default=0.0, at_least=0, doc="receptor concentration on the surface over time"
    )
    ligand: tuple[tuple[float, float], ...] = course(
        default=0.0, at_least=0, doc="ligand concentration on the surface over time"
    )

    @property
    def sticks(self) -> bool:
        """Whether the type ever carries receptors or ligands."""
        return any(value > 0 for _, value in (*self.receptor, *self.ligand))

    def bonds(self, time: float) -> tuple[float, float]:
        """Return receptor and ligand concentration at a time in s."""
        receptor, ligand = (
            float(np.interp(time, [t for t, _ in points], [value for _, value in points]))
            for points in (self.receptor, self.ligand)
        )
        return receptor, ligand


@final
@parameters
class Adhesion:
    """Differential adhesion by receptors and ligands (eq. 3.7), added to the contact law."""

    strength: float = quantity("kPa", default=0.1, at_least=0, doc="f_ad, force per contact area")


@final
@parameters
class Friction:
    """Friction of touching cells, proportional to their contact area."""

    normal: float = quantity(
        "kPa s/um", default=0.1, at_least=0, doc="against motion along the line of centres"
    )
    tangential: float = quantity(
        "kPa s/um", default=0.1, at_least=0, doc="against motion across the line of centres"
    )


@final
@parameters
class Pull:
    """An external force that pulls every cell away from the centre of all cells.

    The run ends when the last contact has broken.
    """

    force: float = quantity("nN", default=0.0, at_least=0, doc="at the start")
    rate: float = quantity("nN/s", default=0.0, at_least=0, doc="at which the force rises")


@final
@parameters
class Motility:
    """Persistent random motion: a constant force whose direction is drawn anew at intervals."""

    force: float = quantity("nN", default=0.1, at_least=0, doc="of every living cell")
    persistence: float = quantity(
        "s", default=600.0, above=0, doc="polarisation time, between two changes of direction"
    )
