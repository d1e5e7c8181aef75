"""All observables: one entry each. History, summary, studies, fits and pictures read them here.

To add one is to write its entry, with a function of the state of a run.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING, Any, Final
from weakref import ref

import numpy as np
from numpy.typing import NDArray

from multicell.cells import Phase
from multicell.results import observables as of
from multicell.results.observable import Observable, TissueState, find_own
from multicell.scene.dependences import counts_contacts
from multicell.scene.domain import walls
from multicell.scene.networks import network_states
from multicell.scene.oxygen import hypoxia_of
from multicell.scene.pairs import compression

if TYPE_CHECKING:
    from multicell.mechanics.sphere import Sphere
    from multicell.mechanics.walls import Walls
    from multicell.scene.scene import Scene

_STATES: Final = ("proliferating", "quiescent", "necrotic", "apoptotic")
_LEDGER: Final = (
    "inflow",
    "outflow",
    "washed",
    "uptake",
    "secreted",
    "decayed",
    "stored",
    "content",
)


def _has_phases(scene: Scene) -> bool:
    return scene.growth is not None and bool(scene.growth.phases)


def _is_pressed(scene: Scene) -> bool:
    return scene.growth is not None and scene.growth.critical_pressure is not None


def _has_walls(scene: Scene) -> bool:
    return _has_volume(scene) and not scene.domain.periodic  # type: ignore[union-attr]


def _has_volume(scene: Scene) -> bool:
    return scene.dimensions == 3 and scene.domain is not None


def _has_gel(scene: Scene) -> bool:
    return scene.domain is not None and scene.domain.stiffness is not None


def _walls(state: TissueState) -> Walls | Sphere:
    """Return the walls as they stand round the cells."""
    found = walls(state.scene)
    assert found is not None
    if _has_gel(state.scene):
        of.settle_gel(state.cells, found, compression(state.scene))
    return found


def _volume(state: TissueState) -> float:
    """Return the volume of the domain, µm³."""
    domain = state.scene.box
    if domain is None or not domain.periodic:
        return _walls(state).volume
    low, high = domain.corners()
    return float(np.prod(np.subtract(high, low)))


def _mean(values: NDArray[Any]) -> float:
    # NumPy's own mean takes three times as long
    return float(values.sum(dtype=float)) / len(values) if len(values) else float("nan")


def _part(count: int, others: int) -> float:
    return count / (count + others) if count + others else float("nan")


def _pressure_factor(state: TissueState) -> float:
    growth = state.scene.growth
    assert growth is not None
    assert growth.critical_pressure is not None
    pressure = state.cells.pressure[~state.cells.dead]
    return _mean(np.clip(1.0 - pressure / growth.critical_pressure, 0.0, 1.0))


def _ki67_positive(state: TissueState) -> float:
    growth, cells, types = state.scene.growth, state.cells, state.scene.types.values()
    assert growth is not None
    assert growth.ki67_decay is not None
    scale = np.array([kind.cycle_scale for kind in types] or [1.0])[cells.kind]
    early = (cells.phase == Phase.G1) & (cells.progress < growth.ki67_decay * scale)
    return _mean((early | (cells.phase > Phase.G1))[~cells.dead])


def _inside(share: float | None, state: TissueState, name: str) -> float:
    """Return a quantile of a state of a network over living cells, or its mean."""
    cells, place = state.cells, network_states(state.scene)[name]
    if cells.inside is None:
        return float("nan")
    values = cells.inside[~cells.dead, place]
    values = values[~np.isnan(values)]
    if share is None or not len(values):
        return _mean(values)
    return float(np.quantile(values, share))


def _over_radius(state: TissueState, length: float) -> float:
    return length / state.extent.radius() if len(state.cells) else float("nan")


NO_CENTRE: Final = "where space repeats"
"""When a population has no centre, and no length round it."""

_length = partial(Observable, unit="um")
_tissue_length = partial(_length, shown="{:.0f} µm".format)
_pressure = partial(Observable, unit="kPa")
_count = partial(Observable, counts=True)
_at_end = partial(Observable, at_end=True)

OBSERVABLES: Final = (
    _count("cells", lambda s: len(s.cells), shown="{:,}".format),
    _tissue_length("diameter", lambda s: s.extent.diameter(), absent=NO_CENTRE, doc="2 R"),
    _length("radius", lambda s: s.extent.radius(), absent=NO_CENTRE, doc="R"),
    _tissue_length(
        "viable_rim",
        lambda s: s.extent.rim(s.extent.dead_core),
        absent="without a core",
        doc="R less the necrotic radius",
    ),
    _tissue_length(
        "proliferating_rim",
        lambda s: s.extent.rim(s.extent.resting_core),
        exists=lambda scene: scene.growth,
        absent="without a region of quiescent and dead cells",
        doc="R less the radius of the [region](measured.md#regions) round the centre in which at "
        "least half of the cells are quiescent or dead",
    ),
    Observable(
        "growth_fraction",
        lambda s: _part(s.state_counts["proliferating"], s.state_counts["quiescent"]),
        exists=lambda scene: scene.growth,
        absent="without living cells",
        doc="part of living cells that proliferate: in the viable rim, where there is a core",
    ),
    _tissue_length(
        "necrotic_radius",
        lambda s: s.extent.dead_core,
        absent=NO_CENTRE,
        title="radius of the necrotic core",
        shown_if_zero=False,
        doc="of the [region](measured.md#regions) round the centre in which at least half of the "
        "cells are dead or have been removed; 0 where there is none, as of scattered dead cells",
    ),
    Observable(
        "necrotic_ratio",
        lambda s: _over_radius(s, s.extent.dead_core),
        exists=_has_phases,
        absent="without cells",
        doc="the necrotic radius over R; with `growth.phases`",
    ),
    _tissue_length(
        "inhibited_radius",
        lambda s: s.extent.inhibited,
        absent=NO_CENTRE,
        exists=_has_phases,
        shown_if_zero=False,
        doc="within it the part of cells in S, G2 or M is below a fifth of that in the outermost "
        "tenth of the cells (isotonic regression over the distance from the centre); at least "
        "the necrotic radius, and R where no cell cycles; with `growth.phases`",
    ),
    Observable(
        "inhibited_ratio",
        lambda s: _over_radius(s, s.extent.inhibited),
        exists=_has_phases,
        absent="without cells",
        doc="the inhibited radius over R; with `growth.phases`",
    ),
    Observable(
        "packing_ratio",
        lambda s: s.extent.packing_ratio(),
        absent="without cells",
        shown="{:.2f}".format,
        doc="sum of the cells' volumes over the volume of the ball of this diameter (areas "
        "over the disc); at most 1 for spheres that do not overlap, since no body has a "
        "smaller radius of gyration than the ball of its volume",
    ),
    _pressure(
        "largest_pressure",
        lambda s: s.cells.pressure.max() if len(s.cells) else 0.0,
        doc="the largest [pressure of a cell](contact.md#pressure-of-a-cell)",
    ),
    *(
        _count(name, lambda s, name=name: s.state_counts[name], entry=f"states.{name}")
        for name in _STATES
    ),
    _count(
        "clonogens",
        lambda s: int((~s.cells.dead & (s.cells.doomed == 0)).sum()),
        exists=lambda scene: scene.radiation,
        shown="{:,}".format,
        doc="living cells that are not doomed; over those before irradiation, without growth, the "
        "surviving fraction; only with `radiation`",
    ),
    _count(
        "doomed",
        lambda s: int((~s.cells.dead & (s.cells.doomed > 0)).sum()),
        exists=lambda scene: scene.radiation,
        doc="living cells that irradiation lets die at one of their next divisions; only with "
        "`radiation`",
    ),
    Observable(
        "volume_fraction",
        lambda s: s.cells.volume.sum() / _volume(s),
        exists=_has_volume,
        doc="sum of the cells' volumes over the volume of the `domain`; in space",
    ),
    _length(
        "domain_radius",
        lambda s: getattr(_walls(s), "radius", float("nan")),
        exists=_has_gel,
        doc="radius to which the cells have widened the cavity of a gel (`domain.stiffness`)",
    ),
    _pressure(
        "wall_pressure",
        lambda s: of.wall_pressure(s.cells, _walls(s), compression(s.scene)),
        exists=_has_walls,
        doc="normal force of the cells on a wall over its area, mean of the six sides of a box; "
        "with elastic walls in space",
    ),
    _pressure(
        "tissue_pressure",
        lambda s: of.tissue_pressure(s.cells, _volume(s)),
        exists=_has_volume,
        signed=True,
        doc="[pressure of the tissue](contact.md#pressure-of-the-tissue), the virial of all "
        "contacts over the volume of the `domain`; at rest it is `wall_pressure`, where there are "
        "walls on all sides; in space",
    ),
    Observable(
        "pressure_factor",
        _pressure_factor,
        exists=_is_pressed,
        absent="without living cells",
        doc=r"mean of $\min(1, \max(0, 1 - p/p_\mathrm{crit}))$ over living cells: the factor of "
        "pressure on growth; only with `growth.critical_pressure`",
    ),
    Observable(
        "ki67_positive",
        _ki67_positive,
        exists=lambda scene: scene.growth and scene.growth.ki67_decay is not None,
        absent="without living cells",
        doc="part of living cells in S, G2 or M, or in G1 with less than `growth.ki67_decay` "
        "behind them there (times the `cycle_scale` of their type); only with it",
    ),
    _count("contacts", lambda s: len(s.frame.contacts), exists=counts_contacts, entry=None),
    Observable(
        "heterotypic_fraction",
        lambda s: of.heterotypic_fraction(s.cells, s.frame.contacts),
        title="contacts between unlike cells",
        exists=lambda scene: len(scene.types) > 1,
        absent="without contacts",
        shown=lambda part: f"{100.0 * part:.1f} %",
        doc="part of all contacts that join cells of different types, where there are several"
        " (`contacts` counts them)",
    ),
    _length(
        "hypoxic_radius_*",
        lambda s, x: s.extent.core(s.concentrations[x] < hypoxia_of(x, s.scene.nutrients)),
        absent=NO_CENTRE,
        exists=lambda scene: [x for x in scene.nutrients if hypoxia_of(x, scene.nutrients)],
        entry="hypoxic_radius.*",
        doc="of the [region](measured.md#regions) round the centre in which at least half of the "
        "cells find less of a field than its `hypoxia`, 10 mmHg of oxygen; 0 where there is none",
    ),
    _count(
        "living_*",
        lambda s, x: (~s.cells.dead & (s.cells.kind == list(s.scene.types).index(x))).sum(),
        title="living cells of a type",
        exists=lambda scene: scene.types if len(scene.types) > 1 else (),
        entry="living.*",
        doc="number of living cells of a type, where there are several",
    ),
    Observable(
        "pull",
        lambda s: s.scene.pull.load(s.time),
        unit="nN",
        exists=lambda scene: scene.pull,
        entry=None,
    ),
    *(
        Observable(
            f"network_{name}_*",
            partial(_inside, share),
            exists=lambda scene: network_states(scene) if scene.networks else (),
            entry=f"networks.*.{name}",
            absent="without living cells that have the network",
            doc=f"{words} of a state of a network over the living cells that have it, in the "
            "network's own unit; `*` is NETWORK_STATE",
        )
        for name, share, words in (
            ("mean", None, "mean"),
            ("low", 0.05, "quantile 0.05"),
            ("high", 0.95, "quantile 0.95"),
        )
    ),
    # found by the coupling step
    Observable(
        "medium_*",
        unit="mM",
        exists=lambda scene: [n for n, f in scene.nutrients.items() if f.finite_medium is not None],
        entry=None,
    ),
    Observable(
        "uptake_*",
        unit="amol/s",
        exists=lambda scene: scene.nutrients,
        entry=None,
        doc="rate at which all cells take up a field",
    ),
    Observable(
        "rim_uptake_*",
        unit="mM/s",
        exists=lambda scene: scene.nutrients if scene.dimensions == 3 else (),
        entry=None,
        absent="without living cells",
        doc="that rate over the volume of the ball of this diameter, less that of the core",
    ),
    Observable(
        "force_*",
        unit="nN",
        exists=lambda scene: [f"{motion}_{axis}" for motion in scene.motions for axis in "xyz"],
        entry=None,
        signed=True,
    ),
    # of the last state only, or of a whole run
    _at_end("divisions", shown="{:,}".format, shown_if_zero=False),
    _at_end("removals", title="cells removed", shown="{:,}".format, shown_if_zero=False),
    _at_end("volume_released", unit="um^3"),
    _at_end("separation.time", unit="s", exists=lambda scene: scene.pull),
    _at_end(
        "separation.force",
        unit="nN",
        title="separation force",
        exists=lambda scene: scene.pull,
        shown="{:.4g} nN".format,
    ),
    *(_at_end(f"ledger.*.{x}", unit="amol", exists=lambda scene: scene.nutrients) for x in _LEDGER),
)


def scene_observables(scene: Scene, *, own: bool = True) -> Iterator[tuple[Observable, str]]:
    """Yield the observables that exist in a scene, each with what stands for its star.

    - ``own``: whether also those of the user's own
    """
    stated = scene.output.observables.items() if own else ()
    owned = [find_own(name, entry) for name, entry in stated]
    yield from _ours(scene)
    for observable in owned:
        for key in observable.keys(scene):
            yield observable, key


_MEMORY: list[tuple[ref[Scene], tuple[tuple[Observable, str], ...]]] = []
"""The latest scene and ours in it, as a run asks in every step; it does not keep a scene alive."""


def _ours(scene: Scene) -> tuple[tuple[Observable, str], ...]:
    for known, found in _MEMORY:
        if known() is scene:
            return found
    found = tuple((o, key) for o in OBSERVABLES for key in o.keys(scene))
    _MEMORY[:] = [(ref(scene), found)]
    return found


def check_observables(scene: Scene) -> None:
    """Raise ``SceneError`` unless all observables that a scene names can be measured in it."""
    for _ in scene_observables(scene):
        pass
