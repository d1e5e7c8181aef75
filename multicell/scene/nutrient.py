"""Nutrients of a scene: transport, boundary, kinetics and effects of a dissolved substance."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import fields
from functools import partial
from typing import Any, final

import numpy as np

from multicell.errors import SceneError
from multicell.scene.formulas import check_formula
from multicell.scene.initial_files import InitialFile
from multicell.schema import (
    choice,
    number,
    parameters,
    quantities,
    quantity,
    schedule,
    specs,
    table,
    tables,
    text,
    vector,
)

MAX_CONCENTRATION = 1e5
"""Largest concentration, mM: more than pure water, 55,500 mM."""

USUAL_UPTAKE = 20.0
"""Largest uptake of a cell where a scene says nothing of it, amol/s: oxygen, by its order."""

_DENSE = "Nothing dissolves to more: pure water is 55,500 mM."
_FLUX = "A cell that takes up its own volume of pure water in a second has 3e7 amol/s."

_level = partial(quantity, "mM", at_least=0, at_most=MAX_CONCENTRATION)
_level_above_zero = partial(quantity, "mM", above=0, at_most=MAX_CONCENTRATION)
_rate = partial(quantity, "1/s", default=0.0, at_least=0, at_most=1e6)
_diffusion = partial(quantity, "um^2/s", at_least=1e-6, at_most=1e8)
_thickness = partial(quantity, "um", default=None, at_most=1e6)
_flux = partial(quantity, "amol/s", at_least=0, at_most=1e9, hint=_FLUX)

FACES = ("*", "r+", "x", "y", "z", "x-", "x+", "y-", "y+", "z-", "z+")
"""Names of the sides of a field's grid, as py-pde has them; ``*`` stands for all others."""


@final
@parameters
class Side:
    """The condition on one side of a field's grid, in py-pde's vocabulary.

    ``value``: c = value on the side; where that is absent it is the medium's at the moment.
    ``derivative``: dc/dn = derivative along the outward normal.
    """

    type: str = choice(["value", "derivative"], default="value", doc="of the condition")
    value: float | None = _level(
        default=None, doc="concentration; absent: that of the medium", hint=_DENSE
    )
    derivative: float | None = quantity(
        "mM/um",
        default=None,
        at_least=0,
        at_most=MAX_CONCENTRATION,
        doc="slope along the outward normal: positive supplies, zero is a wall",
        hint="A drain that takes more than there is would make concentrations negative; "
        "a side brings at most a pure substance within a micrometre.",
    )

    def check(self) -> None:
        """Raise ``SceneError`` for a number that the type needs or has no use for."""
        other = {"value": "derivative", "derivative": "value"}[self.type]
        if getattr(self, other) is not None:
            raise SceneError(other, f"has no meaning on a side of type '{self.type}'")
        if self.type == "derivative" and self.derivative is None:
            raise SceneError("derivative", "is missing on a side of type 'derivative'")


OWN_SOLVERS = ("auto", "multicell-march", "multicell-steady")
"""Values of ``solver`` for which a run takes its own, transient or steady by the regime."""

LEVELS = (
    "boundary",
    "half_saturation",
    "growth_half_saturation",
    "growth_inhibition",
    "quiescence",
    "necrosis",
    "necrosis_above",
    "hypoxia",
)
"""Keys of a field that are concentrations, and may be written as parts of each other."""

_RELATIVE = re.compile(rf"\s*((?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*({'|'.join(LEVELS)})\s*")


@final
@parameters
class Dependence:
    """How the uptake of one field depends on another one's local concentration g.

    The largest uptake is multiplied by 1 + effect · half / (half + g): with a positive effect it
    rises where g falls, with effect = -1 it is g / (half + g) and ends where there is no g.
    """

    effect: float = number(
        at_least=-1, at_most=1e6, doc="relative change of the uptake where g is zero"
    )
    half: float = quantity(
        "mM", above=0, at_most=MAX_CONCENTRATION, doc="concentration g of half the effect"
    )

    def factor(self, g: Any) -> Any:
        """Return the factor on the largest uptake where the other field's concentration is g."""
        return 1.0 + self.effect * self.half / (self.half + g)


@final
@parameters
class FiniteMedium:
    """A stirred volume of medium that the cells use up, in place of one that never changes.

    It begins with the concentration ``boundary``, and at the times of ``media`` fresh medium of the
    concentrations there takes the place of a part of it.
    """

    volume: float = quantity(
        "um^3",
        above=0,
        doc="of the medium in all, with what the field's grid covers",
        hint="A microlitre is 1e9 um^3.",
    )
    replaced: float = number(
        default=1.0, above=0, at_most=1, doc="part of the stirred medium that a change replaces"
    )


@final
@parameters
class Release:
    """An amount that is there at once: at a place, or shared by the cells of a type."""

    amount: float = quantity("amol", above=0, at_most=1e30, doc="in all")
    time: float = quantity("s", default=0.0, at_least=0, doc="of the release")
    place: tuple[float, float, float] | None = vector(
        "um", default=None, doc="where; absent: from cells"
    )
    radius: float = quantity(
        "um", default=0.0, at_least=0, at_most=1e6, doc="of the ball at the place that it fills"
    )
    type: str = text(default="", doc="name of the cells' type that release it, each as much")

    def check(self) -> None:
        """Raise ``SceneError`` unless it comes from a place or from cells."""
        if (self.place is None) == (not self.type):
            hint = "For example place = [0, 0, 0], or type = 'donor'."
            raise SceneError("place", "or a type must be given, and not both", hint)
        if self.radius and self.type:
            raise SceneError("radius", "has no meaning: cells release from their own balls")


@final
@parameters
class Relation:
    """That a concentration is a part of another one of the same field."""

    factor: float = number(above=0, at_most=1e6, doc="times the other concentration")
    to: str = choice(LEVELS, doc="key of the same field")


@final
@parameters
class Nutrient:
    """A dissolved substance: diffusion, boundary, Michaelis-Menten uptake, effect on the cells."""

    diffusion: float = _diffusion(
        default=2000.0,
        doc="diffusion coefficient",
        hint="Oxygen has 2000 um^2/s in tissue, a virus a few, a gas 2e7.",
    )
    diffusion_medium: float | None = _diffusion(
        default=None, doc="outside tissue; absent: the same everywhere"
    )
    boundary: float = _level(default=0.07, doc="concentration in the medium", hint=_DENSE)
    media: tuple[tuple[float, float], ...] | None = schedule(
        "mM",
        at_least=0,
        at_most=MAX_CONCENTRATION,
        doc="[time, concentration] of the medium from these times on",
    )
    temperature: float = number(
        default=37.0,
        at_least=0,
        at_most=60,
        doc="°C, at which '40 mmHg' and '5 %' of oxygen become concentrations",
    )
    finite_medium: FiniteMedium | None = table(
        FiniteMedium, default=None, doc="absent: the cells do not change the medium"
    )
    media_change: str = choice(
        ["steps", "linear"], default="steps", doc="at the times of media, or all the way between"
    )
    sides: Mapping[str, Side] = tables(
        Side, names=FACES, doc="absent: the medium's value on all sides"
    )
    perfusion: float = _rate(doc="exchange with the medium everywhere, a flow through")
    decay: float = _rate(doc="first-order decay")
    uptake: float | None = _flux(
        default=None, doc="largest uptake of a cell; absent: 20 amol/s, or uptake_per_volume"
    )
    uptake_per_volume: float | None = quantity(
        "mM/s",
        default=None,
        at_least=0,
        at_most=1e6,
        doc="largest uptake of a cell over its volume, amol/s/um^3, in place of uptake",
        hint="A cell of 2000 um^3 that takes up 40 amol/s has 0.02 amol/s/um^3.",
    )
    half_saturation: float = quantity(
        "mM",
        default=0.005,
        at_least=1e-12,
        at_most=MAX_CONCENTRATION,
        doc="concentration of half the largest uptake",
        hint="1e-12 mM is one molecule in the volume of a tissue of 0.1 mm.",
    )
    quiescent_uptake: float = number(
        default=0.5, at_least=0, at_most=1, doc="uptake of a quiescent / of a proliferating cell"
    )
    uptake_on: Mapping[str, Dependence] = tables(
        Dependence, doc="how uptake depends on other fields, by name"
    )
    secretion: float = _flux(default=0.0, doc="of a proliferating cell; a quiescent one as uptake")
    secretion_from: Mapping[str, float] | None = quantities(
        "",
        at_least=0,
        at_most=1e6,
        doc="amount secreted for each amount taken up of other fields, by name",
    )
    growth_half_saturation: float | None = _level_above_zero(
        default=None, doc="of half the largest growth (Monod); absent: no effect"
    )
    growth_inhibition: float | None = _level_above_zero(
        default=None, doc="that halves growth; absent: no effect"
    )
    quiescence: float | None = _level(default=None, doc="below: quiescent; absent: never")
    necrosis: float | None = _level(default=None, doc="below: necrotic; absent: never")
    necrosis_above: float | None = _level_above_zero(
        default=None, doc="above: necrotic; absent: never"
    )
    hypoxia: float | None = _level_above_zero(
        default=None,
        doc="below: cells count as hypoxic in hypoxic_radius; absent: 10 mmHg for oxygen, else "
        "never",
    )
    relative: Mapping[str, Relation] = tables(
        Relation,
        names=LEVELS,
        doc="concentrations that are parts of others; necrosis = '0.4 quiescence' is short for it",
    )
    regime: str = choice(
        ["auto", "steady", "transient"],
        default="auto",
        doc="auto: steady where diffusion settles within a coupling step",
    )
    time_tolerance: float = number(
        default=1e-3, at_least=1e-9, at_most=0.1, doc="error of a transient step / concentration"
    )
    solver: str = text(
        default="auto",
        doc="of py-pde's registry, such as explicit, runge-kutta, scipy or multicell-implicit; "
        "auto: multicell-steady or multicell-march, by the regime",
    )
    initial: str = choice(
        ["medium", "steady"], default="medium", doc="where a transient field starts from"
    )
    initial_formula: str = text(
        default="",
        doc="concentration in mM that a transient field starts from: arithmetic of x, y, z in um, "
        "as '0.1 * exp(-(x**2 + y**2) / 400)'; absent: initial says it",
    )
    initial_file: InitialFile | None = table(
        InitialFile,
        default=None,
        shorthand="file",
        doc="values on a grid that a transient field starts from; absent: initial says it",
    )
    release: Mapping[str, Release] = tables(Release, doc="of a transient field; absent: none")
    geometry: str | None = choice(
        ["box", "radial", "auto"],
        default=None,
        doc="a grid of cubes, of spherical shells, or shells as long as the tissue is round; "
        "absent: cubes",
    )
    spacing: float | None = quantity(
        "um", default=None, above=0, doc="of the grid; absent: by diffusion length"
    )
    margin: float = _thickness(
        default=50.0,
        at_least=0,
        doc="thickness of the unstirred layer of medium round the tissue, beyond which stirred "
        "medium has its own concentration; no meaning in a domain, or where layer is given",
    )
    margin_shape: str = choice(
        ["box", "tissue"],
        default="box",
        doc="stirred medium begins at the sides of a box, margin from the outermost cells, or "
        "everywhere margin from the nearest cell: with margin = 0 at the cells' surfaces",
    )
    layer: float | None = _thickness(
        above=0,
        doc="thickness of the unstirred layer round a ball of tissue (geometry = 'radial'), in "
        "place of margin",
    )
    height: float | None = _thickness(
        at_least=1e-3,
        doc="of the medium in 2D that cells share, mixed from top to bottom; absent, where "
        "perfusion feeds from above or nothing is taken up: the largest cell's diameter",
    )

    def prepare(self) -> None:
        """Take texts such as ``"0.4 quiescence"`` for relations, before numbers are read."""
        found: dict[str, Any] = {}
        for field in fields(self):
            given = getattr(self, field.name) if field.name in LEVELS else None
            match = _RELATIVE.fullmatch(given) if isinstance(given, str) else None
            if match is not None:
                found[field.name] = {"factor": float(match[1]), "to": match[2]}
                object.__setattr__(self, field.name, field.default)
        if found and isinstance(self.relative, Mapping):
            object.__setattr__(self, "relative", {**self.relative, **found})

    def _relate(self, name: str, behind: tuple[str, ...] = ()) -> float:
        """Set and return a concentration that may be a part of another."""
        relation = self.relative.get(name)
        value = getattr(self, name)
        if relation is not None:
            if name in behind:
                raise SceneError(name, f"depends on itself: {' of '.join((*behind, name))}")
            value = relation.factor * self._relate(relation.to, (*behind, name))
            object.__setattr__(self, name, specs(type(self))[name].convert(value, name))
        if value is None:
            problem = f"is a part of {name}, which the field does not have"
            raise SceneError(behind[-1], problem, f"Give it {name}.")
        return float(value)

    def check(self) -> None:
        """Raise ``SceneError`` for keys that do not fit together; fill in the usual uptake."""
        for name in self.relative:
            self._relate(name)
        if self.uptake_per_volume is None and self.uptake is None:
            object.__setattr__(self, "uptake", USUAL_UPTAKE)
        elif self.uptake_per_volume is not None and self.uptake is not None:
            problem = "and uptake are given both, must be one of them"
            hint = "uptake is that of a cell whatever its size; remove one of them."
            raise SceneError("uptake_per_volume", problem, hint)
        check_order(self.necrosis, self.quiescence, "mM", "necrosis")
        if self.margin == 0.0 and self.margin_shape == "box" and self.layer is None:
            problem = "is 0 um, so the medium would begin in the middle of the outermost cells"
            hint = "With margin_shape = 'tissue' it begins at their surfaces."
            raise SceneError("margin", problem, hint)
        if self.initial_formula:
            check_formula(self.initial_formula, "initial_formula")
        self._check_beginning()
        if self.geometry == "radial":
            for face in self.sides:
                if face not in ("*", "r+"):
                    hint = "Shells have one side, 'r+'."
                    raise SceneError(f"sides.{face}", "does not exist on a radial grid", hint)
        elif "r+" in self.sides and self.layout == "box":
            raise SceneError("sides.r+", "does not exist on a grid of cubes", "Use 'x-' or '*'.")

    def _check_beginning(self) -> None:
        """Raise ``SceneError`` where a field starts from two things, or shells from values."""
        given = [key for key in ("initial_formula", "initial_file") if getattr(self, key)]
        if len(given) > 1:
            raise SceneError(given[1], f"and {given[0]} are given both, must be one of them")
        if given and self.initial != "medium":
            raise SceneError("initial", f"is '{self.initial}', but there is an {given[0]}")
        if given and self.layout != "box":
            raise SceneError(given[0], "has no meaning on shells", "Take geometry = 'box'.")

    @property
    def takes_up(self) -> bool:
        """Whether any cell takes it up at all."""
        return bool(self.uptake or self.uptake_per_volume)

    def largest_uptake(self, volume: Any) -> Any:
        """Return the largest uptake in amol/s of cells with these volumes in µm³.

        A number where it does not depend on the volume, else what ``volume`` is.
        """
        if self.uptake_per_volume is None:
            return self.uptake
        return self.uptake_per_volume * volume

    @property
    def layout(self) -> str:
        """Kind of its grid: ``"box"``, ``"radial"``, or ``"auto"`` for either."""
        return self.geometry or "box"

    def medium(self, time: float) -> float:
        """Return the concentration of the medium at a time in s, mM."""
        if self.media is None:
            return self.boundary
        first = () if self.media[0][0] <= 0.0 else ((0.0, self.boundary),)
        times, values = np.array([*first, *self.media]).T
        if self.media_change == "linear":
            return float(np.interp(time, times, values))
        return float(values[max(np.searchsorted(times, time, side="right") - 1, 0)])

    def switches(self, begin: float, end: float) -> list[float]:
        """Return the times of the schedule strictly between two times, s."""
        return [t for t, _ in self.media or () if begin < t < end]

    @property
    def highest(self) -> float:
        """The highest concentration that medium and sides ever have, mM."""
        sides = [side.value or 0.0 for side in self.sides.values()]
        return max([self.boundary, *sides, *(value for _, value in self.media or ())])


def check_order(death: float | None, rest: float | None, unit: str, path: str) -> None:
    """Raise ``SceneError`` unless the threshold of death is below that of rest, if both are."""
    if rest is not None and death is not None and not death < rest:
        problem = (
            f"is {death:g} {unit}, must be below quiescence ({rest:g} {unit}): "
            "thresholds in the wrong order"
        )
        raise SceneError(path, problem, "Starving cells first rest, then die.")
