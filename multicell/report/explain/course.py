"""Forecast of a population's size, from a ball of tissue with one radius.

Cells fill a ball (in a plane a disc). Every field that holds back growth or kills is
solved along the radius, steady, with the uptake of living cells; living cells grow where they are
fed, the starved die, and dead ones take room in the middle until they are removed. Where pressure
holds back growth it is the one that drives the tissue outwards against the drag of its cells. Left
out are walls, motion, whatever is not round, irradiation, repair of damage, and responses of single
types or to what cells themselves are. Thresholds are those of the most numerous type.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from multicell.biology.draws import malthusian_rate
from multicell.biology.growth import growth_factor
from multicell.biology.plan import biology_plan
from multicell.biology.responding import rate_of_harm
from multicell.cells import SPHERE, FloatArray
from multicell.scene.dependences import circles, solving_order
from multicell.scene.nutrient import Nutrient
from multicell.scene.pairs import drag
from multicell.scene.responses import type_thresholds, usual_type
from multicell.scene.scales import layer_height, layer_reach
from multicell.scene.scene import Scene
from multicell.scene.sizes import birth_radius, typical_radius

SHELLS: Final = 40  # of the ball of tissue
_STEPS_IN_CYCLE: Final = 12  # steps of the forecast
_NEWBORN: Final = 0.5 / math.log(2.0)
"""Offspring of a newborn cell over that of a mean one of a growing population, in the long run."""
_MAX_STEPS: Final = 300  # of a forecast, which bounds its time
_MAX_EXPONENT: Final = 60.0  # exponent of growth in a step: then it is over
_MAX_CELLS: Final = 1e12  # no forecast continues beyond
_MAX_ITERATIONS: Final = 40  # of bisections: 2^-40 of the first bracket
_TURNS: Final = 8  # in which fields are solved for that depend on each other
_PACKING: Final = 0.77  # volume of cells in that of tissue, as runs have it
_MIN_LIVING: Final = 1e-3  # living cells: with fewer nothing comes any more
_PRESSURE_TOLERANCE: Final = 0.01  # change of pressure's factor that ends its iteration
_FIELD_TOLERANCE: Final = 1e-3  # change of a field, relative to its medium, that ends its iteration


@final
@dataclass(frozen=True)
class Course:
    """The number of cells over simulated time, and the radius of the tissue."""

    times: FloatArray  # (k,), s
    cells: FloatArray  # (k,), dead ones included until they are removed
    radius: FloatArray  # (k,), µm
    starved: float = 0.0  # part of the tissue of the start that finds too little and dies at once
    # by field: largest difference at the surface between directions, over the medium's level
    uneven: Mapping[str, float] = dataclasses.field(default_factory=dict)


def expected_course(scene: Scene) -> Course:
    """Return how the population of a scene is expected to grow, up to the end of its run."""
    times = _times(scene)
    state = _Tissue(scene)
    cells, radius = [state.cells], [state.radius]
    for begin, end in pairwise(times):
        state.advance(float(begin), float(end))
        cells.append(state.cells)
        radius.append(state.radius)
        full = scene.stop_cells is not None and state.cells >= scene.stop_cells
        if full or state.cells > _MAX_CELLS:
            break
    k = len(cells)
    return Course(times[:k], np.array(cells), np.array(radius), state.starved, state.uneven)


def _times(scene: Scene) -> FloatArray:
    if scene.growth is None and scene.death is None:
        return np.array([0.0, scene.duration])
    cycle = scene.duration if scene.growth is None else scene.growth.mean_cycle
    count = int(min(max(_STEPS_IN_CYCLE * scene.duration / cycle, 20), _MAX_STEPS))
    switches = [
        time for field in scene.nutrients.values() for time in field.switches(0.0, scene.duration)
    ]
    return np.unique([*np.linspace(0.0, scene.duration, count + 1), *switches])


class _Tissue:
    """Living cells, and the dead by the time of their death.

    The living are counted as cells of a growing population, whose ages differ: their volume and
    their offspring are those of so many.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._plan = biology_plan(scene)
        self._dimensions = scene.dimensions
        self._living = self._least = float(scene.initial.count)
        self._dead: list[tuple[float, float]] = []
        self._now = 0.0
        self.starved = math.nan  # part of the tissue of the start
        self.uneven: dict[str, float] = {}
        self._factor = np.ones(SHELLS)
        size = typical_radius(scene)
        self._rate = 0.0  # of an unlimited population, 1/s
        if scene.growth is not None:
            self._rate = malthusian_rate(scene.growth)
            if scene.initial.cells is None and scene.initial.stage == "birth":
                self._living *= _NEWBORN
            # of newborn cells over that of growing ones, whose ages fall off by half over a cycle
            size = birth_radius(scene) / math.log(2.0) ** (1.0 / 3.0)
        own = SPHERE * size**3 if scene.dimensions == 3 else math.pi * size**2
        self._volume, self._cell_volume = own / _PACKING, SPHERE * size**3 / _PACKING
        needed = _effective_fields(scene)
        around = circles(scene.nutrients, scene.reactions, scene.responses).values()
        self._circular = any(len(group) > 1 for group in around)
        self._fields = {
            name: Profile(
                scene.nutrients[name],
                self._dimensions,
                layer_height(scene, name),
                type_thresholds(scene, name, "quiescence").get(usual_type(scene.types)),
                partial(layer_reach, scene, name),
            )
            for name in (
                solving_order(scene.nutrients, scene.reactions, scene.responses) if needed else ()
            )
            if name in needed
        }

    @property
    def cells(self) -> float:
        """All cells that are there."""
        return self._number + sum(count for _, count in self._dead)

    @property
    def _number(self) -> float:
        """Living cells: those of the start until the first of them divides."""
        return max(self._living, self._least)

    @property
    def radius(self) -> float:
        """Radius of the tissue, µm."""
        return self._radius(self._living * self._volume + self._core())

    def _radius(self, volume: float) -> float:
        d = self._dimensions
        return float((volume / (math.pi if d == 2 else SPHERE)) ** (1.0 / d))

    def _core(self) -> float:
        death = self._scene.death
        if death is None:
            return sum(count for _, count in self._dead) * self._volume
        left = (n * math.exp(-(self._now - since) / death.lysis_time) for since, n in self._dead)
        return self._volume * sum(left)

    def advance(self, begin: float, end: float) -> None:
        """Grow, starve and remove cells from one time to another."""
        dt = end - begin
        if self._living < _MIN_LIVING:
            return self._clear(end)
        shells = np.linspace(self._radius(self._core()), self.radius, SHELLS + 1)
        share = np.diff(shells**self._dimensions)
        share /= share.sum()
        growth, hazard = self._supply(shells, begin, end)
        growth *= self._pressure_factor(shells, growth)
        if math.isnan(self.starved):  # cells that die at a rate do not at once
            self.starved = min(float(share[np.isinf(hazard)].sum()), 1.0)  # rounding may exceed 1
        if self._scene.growth is not None:
            rate = self._rate * float((share * growth).sum())
            self._living *= math.exp(min(rate * dt, _MAX_EXPONENT))
        lost = min(float((share * -np.expm1(-hazard * dt)).sum()), 1.0)
        if self._scene.death is not None:
            lost += (1.0 - lost) * -math.expm1(-self._scene.death.apoptosis_rate * dt)
        if lost > 0.0:
            self._dead.append((end, lost * self._number))
            self._living *= 1.0 - lost
            self._least *= 1.0 - lost
        self._clear(end)

    def _supply(
        self, shells: FloatArray, begin: float, end: float
    ) -> tuple[FloatArray, FloatArray]:
        """Solve the fields; return growth's factor and the rate of necrosis (1/s) in each shell."""
        scene = self._scene
        # fields without effect on cells are not solved
        levels = {name: np.full(SHELLS, n.medium(begin)) for name, n in scene.nutrients.items()}
        for _ in range(_TURNS if self._circular else 1):
            for name, field in self._fields.items():
                levels[name] = field.solve(shells, begin, end, self._cell_volume, levels)
                cornered = field.nutrient.layout == "box" and not field.nutrient.sides
                if scene.box is None and cornered:
                    self.uneven[name] = max(self.uneven.get(name, 0.0), field.uneven())
        growth = growth_factor(self._plan, levels, np.zeros(SHELLS))
        hazard = self._hazard(levels)
        for name, field in self._fields.items():
            growth *= _active(field.resting, levels[name])
        if scene.energy is not None and scene.energy.quiescence is not None:
            resting = scene.energy.supply(scene.nutrients, levels) < scene.energy.quiescence
            growth[resting] = 0.0
            for field in self._fields.values():
                field.rest(resting)
        growth[np.isinf(hazard)] = 0.0
        return growth, hazard

    def _hazard(self, levels: Mapping[str, FloatArray]) -> FloatArray:
        """Return the rate of necrosis, (SHELLS,) 1/s; of damage as over the time that it takes."""
        hazard = np.zeros(SHELLS)
        found = levels or {"": hazard}  # says how many shells there are where there is no field
        for behaviour in ("necrosis rate", "damage rate"):
            rate = rate_of_harm(self._plan, behaviour, found, None)
            hazard += 0.0 if rate is None else rate
        return hazard

    def _clear(self, end: float) -> None:
        self._now, death = end, self._scene.death
        if death is not None:
            size = 1.0 if self._scene.growth is None else 1.0 / math.log(2.0)  # at birth it is 1
            gone = death.lysis_time * math.log(size / death.removal_fraction)
            self._dead = [(since, n) for since, n in self._dead if end - since < gone]

    def _pressure_factor(self, shells: FloatArray, growth: FloatArray) -> FloatArray:
        """Return the factor of pressure on growth in each shell.

        Tissue that grows at a rate k moves outwards at v = ∫ k r^(d-1) dr / r^(d-1), and the drag
        of its cells, z a cell, is borne by the pressure: p' = -z v / V.
        """
        scene, d = self._scene, self._dimensions
        if scene.growth is None or scene.growth.critical_pressure is None:
            return np.ones(SHELLS)
        resistance = drag(scene, typical_radius(scene)) / self._cell_volume
        rate = self._rate * growth
        width = np.diff(shells)
        factor = self._factor
        for _ in range(_MAX_ITERATIONS):
            flow = np.cumsum(rate * factor * np.diff(shells**d) / d)
            push = resistance * flow / shells[1:] ** (d - 1) * width
            pressure = np.cumsum(push[::-1])[::-1] - 0.5 * push
            new = np.clip(1.0 - pressure / scene.growth.critical_pressure, 0.0, 1.0)
            change = float(np.abs(new - factor).max())
            factor = 0.7 * factor + 0.3 * new
            if change < _PRESSURE_TOLERANCE:
                break
        self._factor = factor
        return factor


def _effective_fields(scene: Scene) -> set[str]:
    """Return the fields that have an effect on how many cells there are, directly or over others.

    What a field depends on that takes part in reactions is left out, as reactions are.
    """
    effects = (
        "growth_half_saturation",
        "growth_inhibition",
        "quiescence",
        "necrosis",
        "necrosis_above",
    )
    fields = scene.nutrients.items()
    needed = {name for name, f in fields if any(getattr(f, x) is not None for x in effects)}
    if scene.energy is not None:
        needed |= set(scene.energy.yields or ())
    while more := {x for name in needed for x in scene.nutrients[name].uptake_on} - needed:
        needed |= more
    return needed


def _active(resting: float | None, level: FloatArray) -> FloatArray:
    """Return where cells do not rest: one, and zero below the threshold of quiescence."""
    return np.ones(len(level)) if resting is None else (level >= resting).astype(np.float64)


@final
class Profile:
    """A steady field along the radius, in shells of living tissue round a core without uptake."""

    def __init__(
        self,
        nutrient: Nutrient,
        dimensions: int,
        height: float = 1.0,
        resting: float | None = None,
        reach: Callable[[float], float] | None = None,
    ) -> None:
        self.nutrient = nutrient
        self._reach = reach or (lambda radius: radius + nutrient.margin)  # along axes, µm
        self._flow = self._surface = 0.0  # mM µm²/s, divided by 4 pi or 2 pi; radius, µm
        self.resting = resting  # threshold of quiescence, mM
        self._height = height  # of the layer in a plane, µm
        self._dimensions = dimensions
        self._last = np.full(SHELLS, nutrient.highest)
        self._medium = nutrient.medium(0.0)
        self._active = np.ones(SHELLS)
        self._factor: Any = 1.0  # of other fields on the uptake

    def rest(self, resting: NDArray[np.bool_]) -> None:
        """Note where cells are quiescent for lack of something else, (n,) bool."""
        self._active = np.where(resting, 0.0, self._active)

    def solve(
        self,
        shells: FloatArray,
        begin: float,
        end: float,
        volume: float,
        others: Mapping[str, FloatArray] | None = None,
    ) -> FloatArray:
        """Return the concentration in each shell, (n,) mM, and note what a finite medium loses.

        - ``shells``, (n + 1,), µm: their boundaries; nothing flows through the innermost
        - ``begin``, ``end``, s: the field is taken at the first, its medium lasts till the second
        - ``volume``, µm³: of a cell
        - ``others``, name -> (n,), mM: fields that are solved already, which uptake may depend on
        """
        medium = self._now(begin)
        self._factor = 1.0
        for other, law in self.nutrient.uptake_on.items():
            self._factor = self._factor * law.factor((others or {})[other])
        # a ball of 4 pi, or a disc of 2 pi, cancels
        d, field = self._dimensions, self.nutrient
        volumes = np.diff(shells**d) / d
        middles = 0.5 * (shells[1:] + shells[:-1])
        between = field.diffusion * shells[1:-1] ** (d - 1) / np.diff(middles)
        inside = (shells[-1] - middles[-1]) / (field.diffusion * shells[-1] ** (d - 1))
        surface = 1.0 / (inside + self._resistance(shells[-1]))
        diagonal = np.zeros(len(volumes))
        diagonal[:-1] += between
        diagonal[1:] += between
        diagonal[-1] += surface
        source = field.perfusion * medium * volumes
        source[-1] += surface * medium
        level: FloatArray = np.minimum(np.maximum(self._last, 0.0), max(medium, 1e-30))
        for _ in range(_MAX_ITERATIONS):
            lost = field.decay + field.perfusion
            sink = volumes * (self._uptake(level, volume) + lost)
            new = _tridiagonal(between, diagonal + sink, source)
            change = float(np.abs(new - level).max())
            level = 0.5 * (level + new)
            if change <= _FIELD_TOLERANCE * max(medium, 1e-30):
                break
        self._last, self._active = level, _active(self.resting, level)
        self._flow, self._surface = surface * (medium - level[-1]), float(shells[-1])
        self._spend(4.0 * math.pi * self._flow, end - begin)
        return level

    def uneven(self) -> float:
        """Return the excess at the last surface along the axes of a box over the diagonals.

        Over the medium's concentration. The field of a source in the middle of a cube with the half
        edge a, relative to that in a ball, differs there by 0.185 (r/a)⁴ / a times the source, in a
        square by 0.148 (r/a)⁴ (by series of harmonics, as their radii). That uptake
        changes with the difference is left out, but where a rim round starved tissue takes up all.
        """
        field, d, radius = self.nutrient, self._dimensions, self._surface
        if field.margin_shape == "tissue" or self._medium <= 0.0:
            return 0.0
        half = self._reach(radius)
        scale = 0.185 / half if d == 3 else 0.148
        found = self._flow / (field.diffusion_medium or field.diffusion)
        found *= scale * (radius / half) ** 4
        level = self._last
        if level[0] < 0.5 * field.half_saturation < level[-1]:
            # a flow through the surface in the fourth harmonic makes R / 9 D of itself there
            found /= 1.0 + self._flow / (18.0 * field.diffusion * radius ** (d - 2) * level[-1])
        return float(found / self._medium)

    def _now(self, time: float) -> float:
        """Return the concentration of the medium, of a finite one that which is left."""
        field = self.nutrient
        if field.finite_medium is None or any(when == time for when, _ in field.media or ()):
            self._medium = float(field.medium(time))
        return self._medium

    def _spend(self, uptake: float, dt: float) -> None:
        """Take from a finite medium what the tissue takes up, amol/s, and what decays."""
        field = self.nutrient
        if field.finite_medium is not None and self._medium > 0.0:
            amount = field.finite_medium.volume * self._medium
            rate = field.decay + max(uptake, 0.0) / amount
            self._medium *= math.exp(-rate * dt)

    def _resistance(self, radius: float) -> float:
        """Return that of the layer of medium, s/µm^d, divided by 4 pi or 2 pi."""
        field = self.nutrient
        end = radius + (field.margin if field.layer is None else field.layer)
        if field.margin_shape == "tissue":
            end = max(self._reach(radius), radius)
        coefficient = field.diffusion_medium or field.diffusion
        if self._dimensions == 2:
            return float(math.log(end / radius) / coefficient)
        return float((end - radius) / (coefficient * radius * end))

    def _uptake(self, level: FloatArray, volume: float) -> FloatArray:
        """Return uptake over concentration, 1/s: amol/s in µm³ are mM/s.

        Quiescence follows the last field: after a switch of the medium all cells take up at first.
        """
        field = self.nutrient
        share = self._active + (1.0 - self._active) * field.quiescent_uptake
        room = volume
        if self._dimensions == 2:
            room = math.pi * (volume / SPHERE) ** (2.0 / 3.0) * self._height
        most = self._factor * (field.largest_uptake(volume) / room)
        return np.asarray(share * most / (field.half_saturation + level))


def _tridiagonal(off: FloatArray, diagonal: FloatArray, right: FloatArray) -> FloatArray:
    """Solve a symmetric positive definite system with ``-off`` beside its diagonal."""
    from scipy.linalg.lapack import dptsv

    _, _, found, trouble = dptsv(diagonal, -off, right)
    assert trouble == 0, "the matrix of diffusion and uptake is positive definite"
    return np.asarray(found)
