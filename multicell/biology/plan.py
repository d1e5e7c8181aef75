"""The biology of a scene, resolved once: constants, arrays and plain parts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, final

import numpy as np
from numpy.typing import NDArray

from multicell.biology.responding import (
    acting,
    bind_responses,
    counted,
    exposed,
    missing_signals,
    one_level,
)
from multicell.biology.waiting import Awaited, awaited_of
from multicell.cells import Mask, Phase
from multicell.scene.sizes import birth_volume, division_volume
from multicell.units import oxygen_solubility

if TYPE_CHECKING:
    from multicell.behaviours.growth_laws.laws import GrowthLaw
    from multicell.biology.inside import Networks
    from multicell.biology.responding import BoundResponse
    from multicell.cells import FloatArray
    from multicell.contact.law import PairLaw
    from multicell.scene.driven import Motions
    from multicell.scene.parts import (
        Adhesion,
        CellParameters,
        CellType,
        Chemotaxis,
        Death,
        Domain,
        Growth,
        Motility,
        Pull,
    )
    from multicell.scene.radiation import Radiation
    from multicell.scene.scene import Scene


@final
@dataclass(frozen=True, eq=False)
class BiologyPlan:
    """The biology of a scene, resolved.

    - ``seed``, ``dimensions``, ``coupling_step``, s: as in the scene
    - ``birth_volume``, ``division_volume``, float, µm³: of types whose size has no scale
    - ``volume_scale``, (types,) or None: of each type on both; None where all are 1
    - ``law``: by which volumes grow; None without growth
    - ``phased``: whether the cycle has phases
    - ``grows``, (5,) bool: for each :class:`multicell.cells.Phase` whether cells grow in it
    - ``waits``, (5,) bool: which phases a condition ends, and ``awaited``: these conditions
    - ``restricted``: whether cells are quiescent in G0 only
    - ``stage``, ``varies``, ``founders``: where in their cycle cells start, whether newborn ones
      draw durations that differ, and below which identity they are founders of a stable population:
      zero where the cycle does not vary or is inherited
    - ``responses``: of each behaviour that responds to anything, by its name
    - ``may_rest``: whether anything makes cells quiescent, or a field in which they may wake
    - ``base_rates``, name -> 1/s: the rate of apoptosis without responses, where cells die so at
      all
    - ``acting``: behaviours that are rates, which act by their integral over a step
    - ``exposed``: signals that these and what kills at once depend on
    - ``counted``: numbers of neighbours that rates and chances at births depend on
    - ``growth_follows_state``: whether growth depends on more than fields and pressure at a cell of
      a type
    - ``elsewhere``: signals that neither fields nor cells carry: time, and numbers of neighbours
    - ``networks``: inside cells; None without any
    - ``receptors``: adhesion by receptors and ligands of cells; None without any
    - ``inflow``: viscosity of the medium that flows in to what is lost, kPa·s; 0: it is at rest
    - ``surface_tension``: of the tissue, nN/µm; 0: none
    - ``types``: by name; empty where all cells are alike
    - ``cycle_scale``, ``motility_scale``, ``young_ratio``, (types,) or None: factors of each type;
      None where they are all 1
    - ``chemotaxis_of``, field -> (types,): factors of types on its force; those that are all 1 are
      left out
    - ``diffusion``, (types or 1,) µm²/s, or None: of Brownian motion
    - ``doubling``, (types or 1,) s, or None: time in which volumes double, for all cells of a type;
      None where it follows from the phases that each cell draws
    - ``target_scale``, (5,) or None: of the volumes that growth goes to, for each phase
    - ``solubility``, field -> mM/kPa: of oxygen, in the fields that modify irradiation
    - ``period``, (3,) µm, or None: lengths after which space repeats, see Domain.period
    - ``cells`` to ``motions``: parts of the scene that hold nothing but numbers and names
    """

    seed: int
    dimensions: int
    coupling_step: float
    birth_volume: float
    division_volume: float
    volume_scale: FloatArray | None
    law: GrowthLaw | None
    phased: bool
    grows: Mask
    waits: Mask
    awaited: tuple[Awaited, ...]
    restricted: bool
    hypertrophy: bool
    stage: str
    varies: bool
    founders: int
    responses: Mapping[str, tuple[BoundResponse, ...]]
    may_rest: bool
    base_rates: Mapping[str, float]
    acting: tuple[str, ...]
    exposed: frozenset[str]
    counted: frozenset[str]
    growth_follows_state: bool
    elsewhere: frozenset[str]
    networks: Networks | None
    inflow: float
    surface_tension: float
    types: Mapping[str, CellType]
    cycle_scale: FloatArray | None
    motility_scale: FloatArray | None
    chemotaxis_of: Mapping[str, FloatArray]
    diffusion: FloatArray | None
    young_ratio: FloatArray | None
    doubling: FloatArray | None
    target_scale: FloatArray | None
    solubility: Mapping[str, float]
    period: FloatArray | None
    cells: CellParameters
    radiation: Mapping[str, Radiation]
    contact: PairLaw
    domain: Domain | None
    growth: Growth | None
    death: Death | None
    receptors: Adhesion | None
    motility: Motility | None
    chemotaxis: Mapping[str, Chemotaxis]
    pull: Pull | None
    motions: Motions

    def birth_volumes(self, kind: NDArray[np.integer]) -> float | FloatArray:
        """Return the volumes in µm³ with which cells of types are born, (n,) or one for all."""
        scale = self.volume_scale
        return self.birth_volume if scale is None else self.birth_volume * scale[kind]

    def division_volumes(self, kind: NDArray[np.integer]) -> float | FloatArray:
        """Return the volumes in µm³ at which cells of types divide, (n,) or one for all."""
        scale = self.volume_scale
        return self.division_volume if scale is None else self.division_volume * scale[kind]


_OF_SCENE: Final = (
    "seed",
    "dimensions",
    "cells",
    "types",
    "radiation",
    "contact",
    "domain",
    "death",
    "motility",
    "chemotaxis",
    "pull",
    "motions",
)


def biology_plan(scene: Scene) -> BiologyPlan:
    """Resolve the biology of a scene."""
    growth, cells, kinds = scene.growth, scene.cells, list(scene.types.values())
    phases = {} if growth is None else growth.phases
    own = [kind.young for kind in kinds]
    known = bind_responses(scene)
    networks, inputs = None, frozenset[str]()
    if scene.networks:
        from multicell.biology.inside import Networks

        networks = Networks(scene, one_level)
        inputs = networks.needs
    awaited = awaited_of(scene)
    growth_signals = {name for part in known.get("growth rate", ()) for name in part.needs}
    rate = 0.0 if scene.death is None else scene.death.apoptosis_rate
    ratio = [1.0 if young is None else young / cells.young for young in own]
    oxygen = [part.oxygen for part in scene.radiation.values() if part.oxygen]
    return BiologyPlan(
        coupling_step=scene.coupling_step,
        receptors=scene.adhesion,
        birth_volume=birth_volume(scene),
        division_volume=division_volume(scene),
        volume_scale=_volume_scale(kinds),
        law=None if growth is None else growth.growth_law,
        phased=bool(phases),
        grows=np.array([p.name in phases and phases[p.name].grows for p in Phase]),
        waits=np.zeros(5, bool) if growth is None else growth.waits,
        awaited=awaited,
        restricted=growth is not None and bool(phases) and growth.restriction,
        hypertrophy=growth is None or growth.hypertrophy,
        stage=scene.initial.stage,
        varies=_varies(scene),
        founders=founders(scene),
        responses=known,
        may_rest=bool(scene.nutrients) or "rest" in known,
        base_rates={"apoptosis rate": rate} if rate or "apoptosis rate" in known else {},
        acting=acting(known),
        exposed=exposed(known),
        counted=counted(known),
        growth_follows_state=not growth_signals <= {"pressure", *scene.nutrients},
        elsewhere=missing_signals(known, inputs.union(*(part.needs for part in awaited))),
        networks=networks,
        inflow=scene.drag.viscosity if scene.death is not None and scene.death.inflow else 0.0,
        surface_tension=0.0 if scene.surface is None else scene.surface.tension,
        cycle_scale=np.array([kind.cycle_scale for kind in kinds]) if kinds else None,
        chemotaxis_of={
            name: np.array([(kind.chemotaxis_of or {}).get(name, 1.0) for kind in kinds])
            for name in scene.chemotaxis
            if any(name in (kind.chemotaxis_of or {}) for kind in kinds)
        },
        diffusion=_diffusion(scene),
        motility_scale=np.array([kind.motility_scale for kind in kinds]) if kinds else None,
        young_ratio=np.array(ratio) if any(own) else None,
        doubling=_doubling(growth, kinds),
        target_scale=None if growth is None else growth.target_scales,
        solubility={name: oxygen_solubility(scene.nutrients[name].temperature) for name in oxygen},
        period=None if scene.domain is None else scene.domain.period,
        growth=growth,
        **{name: getattr(scene, name) for name in _OF_SCENE},
    )


def founders(scene: Scene) -> int:
    """Return below which identity cells are founders of a stable population."""
    initial = scene.initial
    if scene.growth is None or initial.stage != "asynchronous" or not _varies(scene):
        return 0
    if initial.cells is None:
        return initial.count
    given = initial.cells.given
    return int(given.columns["id"].max()) + 1 if "id" in given.columns else len(given)


def _volume_scale(kinds: list[CellType]) -> FloatArray | None:
    """Return the scale of each type on volumes, (types,); None where all are 1."""
    scales = np.array([kind.division_radius_scale for kind in kinds])
    return None if (scales == 1.0).all() else scales**3


def _diffusion(scene: Scene) -> FloatArray | None:
    """Return the diffusion of cells of each type by Brownian motion, (types or 1,) µm²/s."""
    law = scene.motility
    if law is None or law.diffusion is None:
        return None
    scales = [kind.diffusion_scale for kind in scene.types.values()] or [1.0]
    return law.diffusion * np.array(scales)


def _doubling(growth: Growth | None, kinds: list[CellType]) -> FloatArray | None:
    """Return the time in which volumes of each type double, s; None where each cell has its own."""
    if growth is None or growth.volume_doubling_time is None:
        return None
    own = [kind.volume_doubling_time for kind in kinds] or [None]
    return np.array([growth.volume_doubling_time if time is None else time for time in own])


def _varies(scene: Scene) -> bool:
    """Return whether newborn cells draw durations that differ."""
    growth = scene.growth
    if growth is None:
        return False
    if growth.phases:
        return any(part.distribution != "fixed" for part in growth.phases.values())
    return growth.cycle_variation > 0.0 and "cycle_time" not in scene.cells.heritable
