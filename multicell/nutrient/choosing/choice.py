"""The grid and the regime of a field by a tolerance: no finer than needed.

The choice is made for the cells at the start, and again whenever their number, the medium or what
the field holds have changed by a twentieth; of a transient field also as time goes on, less and
less often until the medium changes again. It depends on the state and on the last choice alone,
which frames keep: a run that goes on from a frame chooses as it would have.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Final, NamedTuple, final

from multicell.errors import NutrientFailed, SceneError
from multicell.nutrient.cartesian import FEW
from multicell.nutrient.choosing.estimate import (
    Load,
    Trial,
    apart,
    copied,
    finest_grid,
    lag,
    on_grid,
    remembered,
    spacing_error,
)
from multicell.nutrient.parameters import FieldParameters
from multicell.scene.scales import MAX_NODES, level_fixed, spacing

if TYPE_CHECKING:
    from multicell.nutrient.choosing.estimate import Parameters
    from multicell.nutrient.field import NutrientField
    from multicell.nutrient.group import FieldGroup
    from multicell.scene.scene import Scene


AIM: Final = 0.5
"""Error that a new spacing is chosen for, over the tolerance."""

CHANGED: Final = 0.05
"""Relative change of cells, medium or content from which on a choice is looked at again."""

LATER: Final = 1.25
"""Time since the last change of the medium, over that of the last look, from which on the choice of
a transient field is looked at again."""

BACK: Final = 0.5
"""Part of the tolerance below which cubes go back to shells, and a field begins as steady."""

WORTH: Final = (1.25, 1.8)
"""How much coarser a grid must be to be worth the change, at the start and later on."""

FINEST: Final[Mapping[str, float]] = {"box": 1.0, "radial": 0.25}
"""Smallest spacing over the radius of a dividing cell. Cells are points that take up: cubes
smaller than cells resolve what is not there."""

LOOSE: Final = 1e-3
"""Error in time of the march that shows whether a field settles within a coupling step."""

COARSEST: Final = 4.0
"""Largest spacing over that radius."""

_MOST: Final = 12


@final
@dataclass(frozen=True)
class Choice:
    """What a field lives on and is solved as, and what it was chosen for.

    - ``radial``, ``steady``: shells rather than cubes or squares; steady rather than transient
    - ``spacing``, float, µm: the largest that its grid may have
    - ``error``, float, mM: estimated at the last look: of the spacing, on shells with that of the
      geometry
    - ``nodes``, ``iterations``: of the grid and of a solve then
    - ``cells``, ``level``, ``content``: number of cells, concentration of the medium (mM) and
      content of the field (amol) then
    - ``time``, ``since``, float, s: of the last look, and of the last change of the medium before
      it
    """

    radial: bool
    steady: bool
    spacing: float
    error: float
    nodes: int
    iterations: int
    cells: int
    level: float
    content: float
    time: float
    since: float

    def kept(self) -> dict[str, float]:
        """Return it as numbers, from which :meth:`of` makes it again."""
        return {spec.name: getattr(self, spec.name) + 0 for spec in fields(self)}

    @classmethod
    def of(cls, kept: Mapping[str, float]) -> Choice:
        """Return the choice that was kept."""
        flags = {name: bool(kept[name]) for name in ("radial", "steady")}
        return cls(**{**{spec.name: kept[spec.name] for spec in fields(cls)}, **flags})  # type: ignore[arg-type]

    @property
    def geometry(self) -> str:
        """``"radial"`` or ``"box"``."""
        return "radial" if self.radial else "box"

    def applied(self, parameters: FieldParameters) -> FieldParameters:
        """Return the parameters of a field that has been chosen so."""
        regime = "steady" if self.steady else "transient"
        return replace(on_grid(parameters, self.geometry, self.spacing), regime=regime)


@final
class Fit(NamedTuple):
    """A spacing (µm) with its estimated error (mM) and the trial that gave it."""

    geometry: str
    spacing: float
    error: float
    trial: Trial


@final
class Chooser:
    """Chooses for fields of a scene that share a grid: one, or those that react with each other.

    - ``fits``, list of Fit: the grids between which the last choice was made
    - ``lagged``, float or None, mM: how far the field was from its steady state, where that was
      looked at
    """

    def __init__(self, scene: Scene, *names: str) -> None:
        nutrient, radius = scene.nutrients[names[0]], scene.cells.division_radius
        assert nutrient.tolerance is not None
        self.names, self._tolerance = names, nutrient.tolerance
        self._parameters = {name: FieldParameters.of(scene, name) for name in names}
        self._finest = {kind: share * radius for kind, share in FINEST.items()}
        self._coarsest = COARSEST * radius
        self._first = spacing(scene, names[0])
        rests = level_fixed(nutrient, scene.dimensions)
        self._regime_free = nutrient.regime == "auto" and rests and len(names) == 1
        self.fits: list[Fit] = []
        self.lagged: float | None = None

    def due(self, now: Choice, cells: int, level: float, content: float, time: float) -> bool:
        """Return whether a choice must be looked at again, for what there is now."""
        pairs = ((now.cells, cells), (now.level, level), (now.content, content))
        if any(_changed(a, b) for a, b in pairs):
            return True
        return not now.steady and time - now.since >= LATER * (now.time - now.since)

    def choose(
        self, fields: FieldGroup, load: Load, now: Choice | None, levels: Sequence[float],
        contents: Sequence[float],
    ) -> dict[str, Choice]:  # fmt: skip
        """Return what each field should live on and be solved as.

        - ``fields``: as they are before the coupling step
        - ``load``: the cells as they are after it
        - ``now``: the choice for the first field so far; None at the start
        - ``levels``, mM: of their media after it
        - ``contents``, amol: of the fields before it

        Raises SceneError at the start, if no grid that is allowed reaches the tolerance. Later the
        finest is taken, and the error of the choice says what that is worth; NutrientFailed if a
        trial cannot be solved for.
        """
        level = levels[0]
        steady = self._rests(fields.first, load, now, level)
        regime = "steady" if steady else "transient"
        parameters = {name: replace(own, regime=regime) for name, own in self._parameters.items()}
        since = now.since if now is not None and not _changed(now.level, level) else load.begin
        if steady:
            best = self._grid(fields, parameters, load, now)
        else:
            if now is None:  # there is no grid yet: any of the fields' will do
                fields = copied(fields, parameters)
            past, long = remembered(fields, load, since)
            best = self._grid(past, parameters, long, now)
        time = load.begin if now is None else load.end
        return {
            name: Choice(
                best.geometry == "radial", steady, best.spacing, best.error, best.trial.nodes,
                best.trial.iterations, len(load.position), own_level, content, time, since,
            )
            for name, own_level, content in zip(self.names, levels, contents, strict=True)
        }  # fmt: skip

    def _rests(self, field: NutrientField, load: Load, now: Choice | None, level: float) -> bool:
        """Return whether the steady state is as good as the tolerance.

        At the start for the largest change that the medium makes. What has become transient stays
        so.
        """
        self.lagged = None
        first = self._parameters[self.names[0]]
        if not self._regime_free:
            return first.regime == "steady"
        if now is not None and not now.steady:
            return False
        shells = first.geometry == "radial" or (now is not None and now.radial)
        parameters = on_grid(first, "radial" if shells else "box", self._coarsest)
        loose = max(parameters.nutrient.time_tolerance, LOOSE)
        nutrient = replace(parameters.nutrient, time_tolerance=loose)
        parameters = replace(parameters, nutrient=nutrient)
        levels = (level, level)
        if now is None and nutrient.media is not None:
            known = [level, nutrient.boundary, *(value for _, value in nutrient.media)]
            levels = (min(known), max(known))
        self.lagged = lag(field, parameters, load, levels)
        return self.lagged <= self._tolerance * (BACK if now is None else 1.0)

    def _grid(
        self, fields: FieldGroup, parameters: Parameters, load: Load, now: Choice | None
    ) -> Fit:
        """Return the grid, shells where they may be and are good enough."""
        self.fits = []
        geometry = parameters[self.names[0]].geometry
        if geometry != "auto":
            return self._fit(fields, parameters, geometry, load, now)
        cubes = self._fit(fields, parameters, "box", load, now)
        if len(load.position) <= FEW:
            return cubes
        shells = self._fit(fields, parameters, "radial", load, now, refuse=False)
        shells = shells._replace(error=shells.error + apart(shells.trial, cubes.trial))
        self.fits[-1] = shells
        limit = self._tolerance * (1.0 if now is None or now.radial else BACK)
        return shells if shells.error <= limit else cubes

    def _fit(
        self, fields: FieldGroup, parameters: Parameters, geometry: str, load: Load,
        now: Choice | None, refuse: bool = True,
    ) -> Fit:  # fmt: skip
        """Return the coarsest spacing that does for a geometry, within the worth of a change."""
        tolerance, finest = self._tolerance, self._finest[geometry]
        axes = 1 if geometry == "radial" else parameters[self.names[0]].dimensions
        h, worth = self._first, WORTH[0]
        if now is not None and now.geometry == geometry:
            h, worth = now.spacing, WORTH[1]
        good: Fit | None = None
        failed = False
        for _ in range(_MOST):
            trial = {name: on_grid(own, geometry, h) for name, own in parameters.items()}
            error, found = spacing_error(fields, trial, load, self._coarsest)
            finest = min(max(finest, finest_grid(found, axes)), self._coarsest)
            last = Fit(geometry, h, error, found)
            want = h * math.sqrt(AIM * tolerance / max(error, 1e-300))
            want = min(max(want, finest), self._coarsest)
            if error <= tolerance:
                good = last
                if failed or want < worth * h:
                    break
                h = want
            elif good is not None or h <= finest * (1.0 + 1e-9):
                break
            else:
                failed, h = True, max(min(want, 0.7 * h), finest)
        if good is None and refuse and now is None:
            self._refuse(last)
        self.fits.append(good or last)
        return self.fits[-1]

    def _refuse(self, last: Fit) -> None:
        """Say which tolerance can be reached."""
        reach, others = _rounded_up(last.error), self.names[1:]
        limited = last.spacing > self._finest[last.geometry] * (1.0 + 1e-9)
        why = f"more than {MAX_NODES} nodes" if limited else "finer than cells"
        raise SceneError(
            f"nutrients.{self.names[0]}.tolerance",
            f"is {self._tolerance:g} mM, which no grid reaches for the cells at the start: the "
            f"error is about {reach:g} mM at a spacing of {last.spacing:.3g} um, and beyond that "
            f"a grid would be {why}",
            f"Take {reach:g} mM or more."
            + (f" Those of {', '.join(others)} count in proportion." if others else ""),
        )


def _changed(before: float, after: float) -> bool:
    return abs(before - after) > CHANGED * max(abs(before), abs(after))


def _rounded_up(error: float) -> float:
    """Return an error to two digits, not below it."""
    if not (math.isfinite(error) and error > 0.0):
        problem = f"the error of a grid was estimated as {error:g} mM"
        raise NutrientFailed(problem, "Give the field a spacing in place of a tolerance")
    digit = 10.0 ** (math.floor(math.log10(error)) - 1)
    return float(f"{math.ceil(error / digit * (1.0 - 1e-9)) * digit:.3g}")
