"""The parts of a scene: frozen dataclasses whose declarations are the keys of the TOML file."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from multicell.behaviours.growth_laws.laws import GROWTH_LAWS, GrowthLaw
from multicell.errors import SceneError
from multicell.integrators.base import MethodInfo
from multicell.integrators.registry import METHODS, meant_by
from multicell.plugins.named import OWN_OBJECT, is_recorded_object
from multicell.schema import (
    build_part,
    choice,
    count,
    course,
    flag,
    interval,
    names,
    near_miss,
    number,
    parameters,
    quantities,
    quantity,
    tables,
    text,
    vector,
)
from multicell.units import shown
from multicell.vectors import FloatArray, wrapped

span = partial(interval, "um", at_least=-1e6, at_most=1e6)
"""Declares the ends of something along an axis."""
_stiffness = partial(quantity, "kPa", default=None, above=0, at_most=1e9)
_poisson = partial(
    number, above=-1, at_most=0.5, hint="No isotropic solid has a Poisson ratio above 0.5."
)


@final
@parameters
class CellParameters:
    """Size and elasticity of the cells."""

    division_radius: float = quantity(
        "um",
        default=5.0,
        above=0,
        doc="at which a cell divides; newborn cells, and all without growth, have 0.794 of it",
    )
    young: float = quantity("kPa", default=1.0, above=0, doc="mean Young's modulus")
    young_variation: float = number(
        default=0.1, at_least=0, at_most=0.5, doc="coefficient of variation of Young's modulus"
    )
    poisson: float = _poisson(default=0.5, doc="Poisson ratio")
    reaction_time: float = quantity(
        "s",
        default=7200.0,
        above=0,
        doc="between two decisions of a cell to rest or to proliferate (assumed, not measured)",
    )
    heritable: tuple[str, ...] = names(
        ["young", "cycle_time"], doc="traits that daughters take from their mother"
    )
    drift: Mapping[str, float] | None = quantities(
        "",
        at_least=0,
        at_most=1,
        doc="of heritable traits by name: standard deviation of ln(trait) in one division",
    )
    represents: float | None = number(
        default=None,
        at_least=1,
        at_most=1e6,
        doc="how many cells of the tissue a cell stands for, which counts in results are "
        "multiplied by; absent: 1",
    )

    def check(self) -> None:
        """Raise ``SceneError`` for drift of what is not inherited."""
        for name in self.drift or ():
            if name not in self.heritable:
                known = ", ".join(map(repr, self.heritable)) or "none"
                problem = f"is no trait that daughters inherit (cells.heritable: {known})"
                raise SceneError(f"drift.{name}", problem, near_miss(name, ["young", "cycle_time"]))


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


CYCLE_PHASES = ("G1", "S", "G2", "M")
"""Names of the phases of the cell cycle, in their order."""


@final
@parameters
class PhaseLength:
    """How long a phase of the cycle lasts where nothing limits it, and whether cells grow in it.

    ``shifted-gamma`` is a gamma distribution that begins at ``shift`` times the mean.
    """

    duration: float = quantity("s", above=0, doc="mean duration, for example '7 h'")
    distribution: str = choice(
        ["fixed", "gamma", "shifted-gamma"], default="fixed", doc="of the duration"
    )
    variation: float = number(
        default=0.2, above=0, at_most=1, doc="coefficient of variation, unless fixed"
    )
    shift: float = number(
        default=0.5, at_least=0, below=1, doc="of a shifted gamma distribution / mean"
    )
    grows: bool = flag(default=True, doc="whether the volume grows in this phase")
    target_scale: float = number(
        default=1.0,
        above=0,
        at_most=1e3,
        doc="volume that relaxation goes to in this phase / that of the law",
    )
    after: str | None = text(
        default=None,
        doc="'SIGNAL > VALUE' or 'SIGNAL < VALUE': the phase begins when this comes true in a cell "
        "of the phase before, whatever the duration of that; of G1: the cell divides then",
    )


def loaded_in(laws: Any) -> Callable[[str], bool]:
    """Return a reader for names of loaded laws of the user's own; it refuses those not loaded."""

    def known(name: str) -> bool:
        if ":" in name and name not in laws:
            raise SceneError("law", f"is {shown(name)}, which is not loaded", laws.hint(name))
        return name in laws

    return known


@final
@parameters
class Growth:
    """Growth and division: the volume doubles in one cycle, by a law of growth.

    With T the cycle time, V_b and V_d the volumes at birth and at division, and K = ``target`` V_d:
    linear V' = V_b / T; exponential V' = r V; relaxation V' = r (K - V). The rate r follows from T.

    Without ``phases`` a cell divides at the division volume. With them it passes G1, S, G2 and M
    and divides at the end of M; the volume doubles in the phases in which it grows, and there
    the cycle advances only as fast as growth does. With ``volume_doubling_time`` T is that time for
    all cells: those with short phases divide at smaller volumes.
    """

    cycle_time: float = quantity(
        "s", default=54000.0, above=0, doc="mean shortest cycle time; not used with phases"
    )
    law: str = choice(
        GROWTH_LAWS,
        default="linear",
        doc="how the volume grows in time",
        other=loaded_in(GROWTH_LAWS),
        further=OWN_OBJECT,
    )
    parameters: Mapping[str, float] | None = quantities(
        "", doc="of the law by their names, such as relaxation's target"
    )
    phases: Mapping[str, PhaseLength] = tables(
        PhaseLength, names=CYCLE_PHASES, doc="absent: volume triggers division"
    )
    volume_doubling_time: float | None = quantity(
        "s",
        default=None,
        above=0,
        doc="with phases: in which growth from birth to the division volume takes place, whatever "
        "phases last; absent: as long as the phases of the cell in which it grows",
    )
    ki67_decay: float | None = quantity(
        "s",
        default=None,
        at_least=0,
        doc="with phases: part of G1 after division in which cells are Ki67-positive still, as in "
        "S, G2 and M; absent: no such observable",
    )
    restriction: bool = flag(
        default=True,
        doc="with phases: cells become quiescent only at the end of G1 (in G0)",
    )
    hypertrophy: bool = flag(
        default=True,
        doc="with phases: cells that are held in one grow beyond the volume of division; false: "
        "they stop there",
    )
    cycle_variation: float = number(
        default=0.1, at_least=0, at_most=0.5, doc="coefficient of variation of the cycle time"
    )
    critical_pressure: float | None = quantity(
        "kPa", default=None, above=0, doc="at which growth stops; absent: pressure has no effect"
    )

    def check(self) -> None:
        """Raise ``SceneError`` for phases that make no cycle, and for a law's parameters."""
        build_part(GROWTH_LAWS[self.law], self.parameters or {}, "parameters")
        if not self.phases:
            for name in ("volume_doubling_time", "ki67_decay"):
                if getattr(self, name) is not None:
                    raise SceneError(name, "needs phases", "Without them there is cycle_time.")
            return
        for name in CYCLE_PHASES:
            if name not in self.phases:
                problem = "is missing: a cycle has all of G1, S, G2 and M"
                raise SceneError(f"phases.{name}", problem, "Give it a duration.")
        if not any(phase.grows for phase in self.phases.values()):
            hint = "Let grows = true in one phase at least."
            raise SceneError("phases", "have no phase in which cells grow", hint)
        own_pace = [] if self.volume_doubling_time is None else ["volume_doubling_time"]
        waits = [name for name in CYCLE_PHASES if self.phases[name].after is not None]
        for key in (*own_pace, *(f"phases.{name}.after" for name in waits)):
            if self.law == "exponential":
                hint = "Take law = 'linear' or 'relaxation'."
                problem = "lets sizes wander without bound where growth is exponential"
                raise SceneError(key, problem, hint)
        for name, phase in self.phases.items():
            if phase.target_scale != 1.0 and self.law != "relaxation":
                raise SceneError(f"phases.{name}.target_scale", "needs law = 'relaxation'")

    @property
    def growth_law(self) -> GrowthLaw:
        """The law with its parameters."""
        return GROWTH_LAWS[self.law](**(self.parameters or {}))

    @property
    def target_scales(self) -> FloatArray | None:
        """Of each phase, G0 first, (5,); None where all are 1."""
        if not self.phases:
            return None
        scales = [1.0, *(self.phases[name].target_scale for name in CYCLE_PHASES)]
        return None if set(scales) == {1.0} else np.array(scales)

    @property
    def waits(self) -> NDArray[np.bool_]:
        """Which phases end by a condition and not by their duration, G0 first, (5,)."""
        after = [self.phases[name].after is not None for name in CYCLE_PHASES if self.phases]
        return np.array([False, *after[1:], *after[:1]] if after else [False] * 5)

    @property
    def signals(self) -> frozenset[str]:
        """The signals that start phases."""
        texts = (phase.after for phase in self.phases.values() if phase.after)
        return frozenset(re.split("[<>]", text)[0].strip() for text in texts)

    @property
    def mean_cycle(self) -> float:
        """Mean time of a cycle that nothing limits, s."""
        if not self.phases:
            return self.cycle_time
        return sum(self.phases[name].duration for name in CYCLE_PHASES)


@final
@parameters
class Death:
    """How cells die and go: the dead lose their volume exponentially, then they are removed.

    Necrotic cells may swell first: exponentially to ``swelling`` times their volume within
    ``swelling_time``, at the end of which they burst.

    With ``damage_time`` T a threshold of necrosis does not kill but damages: dD/dt = 1/T beyond it.
    A cell dies where D is at its own tolerance, 1 in the mean. With a ``repair_rate`` damage heals.
    """

    necrosis_rate: float | None = quantity(
        "1/s",
        default=None,
        above=0,
        doc="at which cells die beyond a threshold of necrosis; absent: they die at once",
    )
    damage_time: float | None = quantity(
        "s", default=None, above=0, doc="beyond a threshold of necrosis until a mean cell dies"
    )
    damage_variation: float = number(
        default=0.0, at_least=0, at_most=1, doc="coefficient of variation (gamma) of the tolerance"
    )
    repair_rate: float = quantity(
        "1/s",
        default=0.0,
        at_least=0,
        doc="part of its damage that a cell heals in a time, D' = k/tolerance - repair_rate D",
    )
    swelling: float = number(
        default=1.0, at_least=1, at_most=8, doc="volume of a necrotic cell that bursts / at death"
    )
    swelling_time: float = quantity(
        "s", default=21600.0, above=0, doc="from death to bursting, where cells swell"
    )
    lysis_time: float = quantity(
        "s", default=172800.0, above=0, doc="mean time in which necrotic cells lose their volume"
    )
    apoptosis_rate: float = quantity(
        "1/s", default=0.0, at_least=0, doc="at which living cells die by themselves"
    )
    apoptosis_time: float = quantity(
        "s", default=28800.0, above=0, doc="mean time in which apoptotic cells lose their volume"
    )
    removal_fraction: float = number(
        default=0.1, above=0, below=1, doc="of the birth volume, below which a cell is removed"
    )

    inflow: bool = flag(
        default=False,
        doc="the medium that drags the cells flows in to where the dead lose volume, and takes the "
        "tissue along; false: the medium is at rest",
    )

    def check(self) -> None:
        """Raise ``SceneError`` for two laws of the same death."""
        if self.necrosis_rate is not None and self.damage_time is not None:
            hint = "Leave one out: exponential times are damage_time with damage_variation = 1."
            raise SceneError("necrosis_rate", "contradicts damage_time", hint)


@final
@parameters
class IntegratorOptions:
    """How the equations of motion are integrated."""

    method: str = choice(
        METHODS,
        default="auto",
        doc="name of the method; of a method of the user's own where it came from",
        other=is_recorded_object,
        further=OWN_OBJECT,
        hint=meant_by,
    )
    rtol: float = number(default=1e-6, at_least=1e-14, at_most=0.1, doc="relative tolerance")
    atol: float | None = quantity(
        "um",
        default=None,
        above=0,
        at_least=1e-15,
        doc="absolute tolerance; absent: that of the method",
    )
    max_steps: int = count(default=10000, at_least=1, doc="most steps in one coupling step")
    step: float = quantity("s", default=10.0, above=0, doc="step of the methods with a fixed step")
    max_displacement: float = number(
        default=0.5, above=0, at_most=1, doc="largest move in one step / radius of the cell"
    )

    @property
    def tolerance(self) -> float:
        """Absolute tolerance, µm: the one that is given, or that of the method."""
        return METHODS.get(self.method, MethodInfo).atol if self.atol is None else self.atol


@final
@parameters
class OwnObservable:
    """An observable of the user's own, which the history and the summary hold.

    The entry says what its numbers are to those who read results. It runs nothing: the function is
    found by its name among those that :func:`multicell.observable` has made in this process.
    """

    function: str = text(doc="'file.py:name@fingerprint' of its function")
    unit: str = text(default="", doc="base unit of its numbers; absent: they are counts or ratios")


@final
@parameters
class OutputOptions:
    """Options of the output."""

    every: float = quantity("s", default=21600.0, above=0, doc="simulated time between frames")
    observables: Mapping[str, OwnObservable] = tables(
        OwnObservable, doc="of the user's own, by name; absent: none"
    )


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
    adhesion_with: Mapping[str, float] | None = quantities(
        "",
        at_least=0,
        at_most=1e6,
        doc="factors on the law's surface energy, or on its attraction if it has none, in contacts "
        "with each type, by name; one of two types may state it; absent: 1",
    )
    receptor: tuple[tuple[float, float], ...] = course(
        default=0.0, at_least=0, doc="receptor concentration on the surface over time"
    )
    ligand: tuple[tuple[float, float], ...] = course(
        default=0.0, at_least=0, doc="ligand concentration on the surface over time"
    )
    quiescence_of: Mapping[str, float] | None = quantities(
        "", at_least=0, at_most=1e6, doc="factors on the quiescence of fields, by name; 0: never"
    )
    necrosis_of: Mapping[str, float] | None = quantities(
        "", at_least=0, at_most=1e6, doc="factors on the necrosis of fields, by name; 0: never"
    )
    cycle_scale: float = number(
        default=1.0,
        at_least=1e-9,
        at_most=1e12,
        doc="duration of the cycle or its phases / that of the scene",
    )
    volume_doubling_time: float | None = quantity(
        "s", default=None, above=0, doc="as in growth, where that has one; absent: that of growth"
    )
    uptake_scale: float = number(
        default=1.0, at_least=0, doc="uptake and secretion / those of the scene's fields"
    )
    secretion_scale: float | None = number(
        default=None, at_least=0, doc="secretion / that of the fields; absent: as uptake_scale"
    )
    uptake_of: Mapping[str, float] | None = quantities(
        "", at_least=0, at_most=1e6, doc="further factors on the uptake of fields, by name"
    )
    secretion_of: Mapping[str, float] | None = quantities(
        "", at_least=0, at_most=1e6, doc="further factors on the secretion of fields, by name"
    )
    division_radius_scale: float = number(
        default=1.0,
        at_least=0.1,
        at_most=10,
        doc="radius at which a cell of the type divides / cells.division_radius",
    )
    motility_scale: float = number(
        default=1.0, at_least=0, doc="active forces / those of the scene"
    )
    chemotaxis_of: Mapping[str, float] | None = quantities(
        "",
        at_least=-1e6,
        at_most=1e6,
        doc="factors on the forces of chemotaxis, by field; negative: the other way, 0: not at all",
    )
    diffusion_scale: float = number(
        default=1.0, at_least=0, at_most=1e6, doc="diffusion by motility / that of the scene"
    )

    @property
    def sticks(self) -> bool:
        """Whether the type ever carries receptors or ligands."""
        return any(value > 0 for _, value in (*self.receptor, *self.ligand))

    def bonds(self, time: float) -> tuple[float, float]:
        """Return receptor and ligand concentration at a time in s."""
        courses = (np.transpose(points) for points in (self.receptor, self.ligand))
        receptor, ligand = (float(np.interp(time, *course)) for course in courses)
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
class Surface:
    """Tension of the surface between tissue and medium, also of that round holes in it."""

    tension: float = quantity(
        "nN/um", above=0, at_most=1e3, doc="of the surface of the tissue, in mN/m = nN/um"
    )


@final
@parameters
class Compression:
    """Resistance of tissue to compression by all neighbours of a cell together; in space only."""

    bulk_modulus: float = quantity(
        "kPa", default=10.0, above=0, at_most=1e6, doc="of close-packed cells above the onset"
    )
    onset: float = number(
        default=1.0,
        at_least=0.85,
        at_most=2.0,
        doc="volume fraction, of cells over space, below which nothing resists but the contacts",
        hint="Equal spheres touch at 0.74; at 1 the cells leave no gaps.",
    )


@final
@parameters
class Pull:
    """An external force that pulls every cell away from the centre of all cells.

    The run ends when the last contact has broken.
    """

    force: float = quantity("nN", default=0.0, at_least=0, doc="at the start")
    rate: float = quantity("nN/s", default=0.0, at_least=0, doc="at which the force rises")

    def load(self, time: float) -> float:
        """Return the force on each cell at a time in s, nN."""
        return self.force + self.rate * time


@final
@parameters
class Chemotaxis:
    """A force along the gradient of a field: ``force · ∇c / (|∇c| + half)``, of living cells."""

    force: float = quantity("nN", default=0.1, doc="in a steep gradient; negative: down it")
    half: float = quantity("mM/um", default=1e-4, above=0, doc="gradient of half the force")


@final
@parameters
class Motility:
    """Random motion: a constant force whose direction is drawn anew at intervals, and diffusion.

    Diffusion is Brownian motion. It enters as a random force that is constant over an internal
    step, so that all methods of integration follow the same path.

    With a bias b its direction is that of ``b u + (1 - |b|) e``: e is drawn at random, u is the
    fixed ``direction``, or that of the gradient of the field ``towards`` where the cell is.
    """

    force: float = quantity(
        "nN",
        default=None,
        at_least=0,
        doc="of every living cell; absent: 0.1 nN, or none where cells diffuse",
    )
    persistence: float = quantity(
        "s", default=600.0, above=0, doc="polarisation time, between two changes of direction"
    )
    renewal: str = choice(
        ["regular", "random"],
        default="regular",
        doc="each polarisation time, or at random moments (Poisson) with that mean between them",
    )
    bias: float = number(
        default=0.0, at_least=-1, at_most=1, doc="b; 0: random, 1: always along u, negative: away"
    )
    direction: tuple[float, float, float] | None = vector(
        "", default=None, doc="that a bias is along, of any length"
    )
    towards: str = text(default="", doc="name of the field whose gradient a bias is along")
    diffusion: float | None = quantity(
        "um^2/s",
        default=None,
        above=0,
        at_most=1e6,
        doc="D of living cells that touch nothing, by Brownian motion beside the force: their mean "
        "square displacement in a time t is 2 D t along each axis",
    )
    diffusion_step: float | None = quantity(
        "s",
        default=None,
        above=0,
        at_least=1e-6,
        doc="internal step: longest time for which the force of diffusion is constant, halved from "
        "above to a power of two of the coupling step; absent: a free cell diffuses a fifth of its "
        "birth radius in it",
    )

    def prepare(self) -> None:
        """Let cells that diffuse have no force unless one is given."""
        if self.force is None:
            object.__setattr__(self, "force", 0.1 if self.diffusion is None else 0.0)

    @property
    def pushes(self) -> bool:
        """Whether cells have a force beside their diffusion."""
        return self.force > 0.0 or self.diffusion is None

    def check(self) -> None:
        """Raise ``SceneError`` for keys without effect, and for a bias along nothing."""
        if self.diffusion_step is not None and self.diffusion is None:
            raise SceneError("diffusion_step", "has no effect: there is no motility.diffusion")
        if self.bias and not self.pushes:
            hint = "Give motility.force, or leave bias out."
            raise SceneError("bias", "has no effect: cells diffuse, and have no force", hint)
        given = [name for name in ("direction", "towards") if getattr(self, name)]
        if self.bias and len(given) != 1:
            problem = "needs a direction, or a field that it is towards; not both"
            raise SceneError("bias", problem, "For example direction = [1, 0, 0].")
        if given and not self.bias:
            raise SceneError(given[0], "has no effect: motility.bias is 0")
        if self.direction is not None and not any(self.direction):
            raise SceneError("direction", "is zero, must point somewhere")


@final
@parameters
class Domain:
    """A box that stands still: fields live on it, and its sides are elastic walls for the cells.

    Absent, a field's grid is laid round the cells anew in every step. So it is in a sphere, a wall
    about the origin that fields pass; with a stiffness it is the cavity of an elastic gel.
    """

    shape: str = choice(["box", "sphere"], default="box", doc="sphere: a wall for cells alone")
    radius: float | None = quantity(
        "um",
        default=None,
        above=0,
        doc="of the sphere; of the cavity of a gel, where it is at rest",
    )
    stiffness: float | None = _stiffness(
        doc="Young's modulus of an elastic gel round the sphere; absent: the wall is rigid",
    )
    x: tuple[float, float] | None = span(doc="from side x- to side x+")
    y: tuple[float, float] | None = span(doc="from side y- to side y+")
    z: tuple[float, float] | None = span(doc="from side z- to side z+; not in two dimensions")
    periodic: tuple[str, ...] = names(
        "xyz",
        doc="axes of a box along which space repeats, as ['x', 'y']: no walls stand there, and "
        "cells and fields meet those at the other side",
    )
    young: float | None = _stiffness(doc="Young's modulus of the walls; absent: that of the cells")
    poisson: float | None = _poisson(
        default=None, doc="Poisson ratio of the walls; absent: that of the cells"
    )

    def check(self) -> None:
        """Raise ``SceneError`` for keys that have no meaning together."""
        sphere = self.shape == "sphere"
        for name in ("x", "y", "z", "periodic") if sphere else ("radius", "stiffness"):
            if getattr(self, name):
                raise SceneError(name, f"has no meaning where shape = '{self.shape}'")
        if sphere and self.radius is None:
            raise SceneError("radius", "is missing: a sphere has one", "Such as '100 um'.")

    @property
    def repeats(self) -> tuple[bool, bool, bool]:
        """Whether space repeats along each axis."""
        x, y, z = (axis in self.periodic for axis in "xyz")
        return x, y, z

    @property
    def period(self) -> FloatArray | None:
        """Length after which space repeats along each axis, (3,) µm, zero where it does not."""
        if not self.periodic:
            return None
        low, high = self.corners()
        return np.where(self.repeats, np.subtract(high, low), 0.0)

    def inside(self, position: FloatArray) -> FloatArray:
        """Return the images of places (n, 3) in µm that lie in the domain, where space repeats."""
        period = self.period
        if period is None:
            return position
        low = np.where(self.repeats, self.corners()[0], 0.0)
        return low + wrapped(position - low, period)

    def sides(self) -> tuple[FloatArray, FloatArray]:
        """Return the lower and the upper walls of a box, (3,) µm, infinite where there is none."""
        low, high = self.corners()
        return np.where(self.repeats, -np.inf, low), np.where(self.repeats, np.inf, high)

    def corners(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """Return the lower and the upper corner, µm, infinite along an axis that is absent."""
        free = (-np.inf, np.inf)
        (a, b), (c, d), (e, f) = (side or free for side in (self.x, self.y, self.z))
        return (a, c, e), (b, d, f)
