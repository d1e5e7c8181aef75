"""The population at the start of a run: as a table gives it, what is left open is drawn."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from multicell import random
from multicell.biology.cycle import (
    growing_time,
    place_by_volume,
    place_in_cycle,
    share_of_growth,
    time_before_phase,
    volume_in_phase,
    volume_ratio,
)
from multicell.biology.draws import (
    draw_cycle_times,
    draw_kinds,
    draw_lengths,
    draw_moduli,
    stages,
)
from multicell.biology.plan import BiologyPlan, biology_plan
from multicell.cells import SPHERE, Cells, FloatArray, IntArray, Phase, State
from multicell.random import Purpose

if TYPE_CHECKING:
    from multicell.scene.scene import Scene
    from multicell.scene.start_table import Given


def initial_cells(scene: Scene) -> Cells:
    """Return the cells that a run starts with.

    The scene's ``initial`` part says how many, how arranged, how far apart (centre distance over
    mean diameter), how much displaced at random, and at which stage of growth; ``cells`` and
    ``growth`` give size, moduli and cycle times. With a table the cells are those that it gives, in
    its order. What has no column is drawn as for others, with random numbers that depend on the
    seed and the identity of a cell alone. Radius, age and place in the cycle belong together: of
    those that are missing each follows from those that are there.

    Returns Cells: identities 0 ... n - 1 from the centre outwards, in a row along x, or those of
    the table, else numbered by its rows; parent -1. Without a table all proliferate at pressure
    zero, with the centroid of the sites at the origin.
    """
    n, given, kind = scene.initial.count, None, None
    columns: Mapping[str, NDArray[Any]] = {}
    table = scene.initial.cells
    if table is not None:
        from multicell.scene.start_checks import check_start_table, kinds_of
        from multicell.scene.start_table import positions

        check_start_table(scene)
        given, kind = table.given, kinds_of(scene, table.given)
        n, columns = len(given), given.columns
    plan = biology_plan(scene)
    ids = columns.get("id", np.arange(n, dtype=np.int64))
    kind = draw_kinds(plan, ids) if kind is None else kind
    cells = Cells(
        id=ids,
        parent=np.full(n, -1, dtype=np.int64),
        position=np.zeros((n, 3)) if given is None else positions(given),
        radius=np.ones(n),
        young=columns["young"] if "young" in columns else draw_moduli(plan, ids, kind),
        poisson=columns.get("poisson", np.full(n, scene.cells.poisson)),
        state=_states(columns, n),
        age=np.zeros(n),
        cycle_time=np.full(n, np.inf),
        pressure=columns.get("pressure", np.zeros(n)),
        kind=kind,
        doomed=columns.get("doomed", np.zeros(n, dtype=np.int8)),
        damage=columns.get("damage", np.zeros(n)),
        lag=columns.get("lag", np.zeros(n)),
    )
    volume = (_in_phases if plan.phased else _without_phases)(plan, cells, given)
    cells.radius = columns.get("radius", np.cbrt(volume / SPHERE))
    if given is None:
        cells.position = _positions(scene, ids, cells.radius)
        return cells
    if "age" in columns:
        cells.age = columns["age"]
    elif cells.dead.any():
        cells.age = np.where(cells.dead, 0.0, cells.age)
    return cells.copy()  # the table stays as it is


def packed_ball(count: int) -> FloatArray:
    """Return (count, 3) sites of a hexagonal close packing, cut to a ball.

    Nearest neighbours are at distance 1. The sites are those nearest to a site of the lattice,
    in the order of their distance from it; their centroid is then moved to the origin.
    """
    # a close packing has sqrt(2) sites a unit volume; 2 more cover the surface of small balls
    reach = (3.0 * count / (4.0 * np.pi * np.sqrt(2.0))) ** (1.0 / 3.0) + 2.0
    half = int(np.ceil(reach / np.sqrt(2.0 / 3.0))) + 1
    i, j, k = np.ogrid[-half : half + 1, -half : half + 1, -half : half + 1]
    shape = np.broadcast_shapes(i.shape, j.shape, k.shape)
    x = np.broadcast_to(i + 0.5 * ((j + k) % 2), shape).ravel()
    y = np.broadcast_to(0.5 * np.sqrt(3.0) * (j + (k % 2) / 3.0), shape).ravel()
    z = np.broadcast_to(np.sqrt(2.0 / 3.0) * k, shape).ravel()
    sites = np.stack([x, y, z], axis=1)
    square = (sites**2).sum(axis=1)
    near = square <= reach**2
    sites, square = sites[near], square[near]
    # sites of one shell differ by rounding only: rank them by their coordinates
    order = np.lexsort((*sites.T, np.round(square, 6)))[:count]
    return np.asarray(sites[order] - sites[order].mean(axis=0))


def packed_disc(count: int) -> FloatArray:
    """Return (count, 3) sites of a hexagonal packing in the plane z = 0, cut to a disc."""
    half = int(np.ceil(np.sqrt(count))) + 2
    i, j = np.indices((2 * half + 1, 2 * half + 1)).reshape(2, -1) - half
    sites = np.stack([i + 0.5 * (j % 2), np.sqrt(0.75) * j, np.zeros(len(i))], axis=1)
    square = (sites**2).sum(axis=1)
    order = np.lexsort((*sites.T, np.round(square, 6)))[:count]
    return np.asarray(sites[order] - sites[order].mean(axis=0))


def row(count: int) -> FloatArray:
    """Return ``count`` sites along x at distance 1, their centroid at the origin: (count, 3)."""
    sites = np.zeros((count, 3))
    sites[:, 0] = np.arange(count) - 0.5 * (count - 1)
    return sites


def _positions(scene: Scene, ids: IntArray, radius: FloatArray) -> FloatArray:
    """Return the starting positions (n, 3), µm, of cells with these radii, (n,) µm."""
    diameter = 2.0 * float(radius.mean())
    flat = scene.dimensions == 2
    packed = packed_disc if flat else packed_ball
    if scene.initial.shape == "row":
        packed = row
    position = packed(len(ids)) * (scene.initial.spacing * diameter)
    if scene.initial.jitter > 0.0:
        z = random.normal(scene.seed, Purpose.PLACEMENT, 0, ids, 3)
        z[:, 2] *= not flat
        position = position + scene.initial.jitter * diameter * z
    return position


def _states(columns: Mapping[str, NDArray[Any]], count: int) -> NDArray[np.int8]:
    """Return the states of the cells; those in G0 rest where nothing else is said."""
    if "state" in columns:
        return columns["state"]
    phase = columns.get("phase", np.full(count, Phase.G1))
    resting = phase.any() & (phase == Phase.G0)
    return np.where(resting, np.int8(State.QUIESCENT), np.int8(State.PROLIFERATING))


def _volumes(plan: BiologyPlan, cells: Cells, given: Given | None) -> FloatArray | None:
    """Return the volumes of the cells over that at birth, (n,), if a table has them."""
    radius = None if given is None else given.columns.get("radius")
    return (
        None if radius is None else np.asarray(SPHERE * radius**3 / plan.birth_volumes(cells.kind))
    )


def _without_phases(plan: BiologyPlan, cells: Cells, given: Given | None) -> FloatArray:
    """Give cells cycle times and ages; return their volumes, µm³."""
    drawn = draw_cycle_times(plan, cells.id, cells.kind)
    cells.cycle_time = drawn if given is None else given.columns.get("cycle_time", drawn)
    volume = _volumes(plan, cells, given)
    if volume is not None:
        progress = share_of_growth(plan, volume)
    elif given is not None and "age" in given.columns and plan.growth is not None:
        progress = _share_of_cycle(cells, given, cells.cycle_time)
    else:
        progress = stages(plan, cells.id, cells.kind, cells.cycle_time)
    if plan.growth is not None:
        cells.age = progress * cells.cycle_time
    ratio = volume_ratio(plan, progress) if volume is None else volume
    return np.asarray(plan.birth_volumes(cells.kind) * ratio)


def _in_phases(plan: BiologyPlan, cells: Cells, given: Given | None) -> FloatArray:
    """Give cells their place in the cycle; return their volumes, µm³."""
    lengths = draw_lengths(plan, cells.id, cells.kind)
    whole = lengths.sum(axis=1)
    if given is None:
        share = stages(plan, cells.id, cells.kind, whole)
        birth = plan.birth_volumes(cells.kind)
        return np.asarray(birth * place_in_cycle(plan, cells, lengths, share))
    columns = given.columns
    cells.cycle_time = columns.get("cycle_time", growing_time(plan, lengths, cells.kind))
    volume = _volumes(plan, cells, given)
    if "phase" in columns:
        cells.phase = columns["phase"]
        _in_given_phase(plan, cells, given, lengths)
    elif volume is not None:
        place_by_volume(plan, cells, volume)
    else:
        share = stages(plan, cells.id, cells.kind, whole)
        if "age" in columns:
            share = _share_of_cycle(cells, given, whole)
        own = cells.cycle_time
        place_in_cycle(plan, cells, lengths, share)
        cells.cycle_time = own
    cells.age = time_before_phase(plan, cells)[:, 0] + cells.progress
    return np.asarray(plan.birth_volumes(cells.kind) * volume_in_phase(plan, cells))


def _in_given_phase(plan: BiologyPlan, cells: Cells, given: Given, lengths: FloatArray) -> None:
    """Say how long cells are to be in the phases that the table gives, and have been."""
    columns, resting = given.columns, cells.phase == Phase.G0
    own = np.where(resting, 0.0, lengths[np.arange(len(cells)), cells.phase - 1])
    cells.phase_length = columns.get("phase_length", own)
    if "progress" in columns:
        cells.progress = columns["progress"]
        beyond = (cells.progress > cells.phase_length) & ~cells.dead & ~plan.waits[cells.phase]
        problem = "is {}, more than the length of the phase that is drawn for the cell"
        hint = "Give a column 'phase_length_s', or leave progress out."
        given.refuse(beyond, "progress", problem, hint)
        return
    share = np.zeros(len(cells))
    if plan.stage != "birth":
        share = random.uniform(plan.seed, Purpose.STAGE, 0, cells.id)[:, 0]
    cells.progress = share * cells.phase_length


def _share_of_cycle(cells: Cells, given: Given, cycle: FloatArray) -> FloatArray:
    """Return the part of the cycle that cells have behind them by their age, (n,)."""
    share = given.columns["age"] / cycle
    share = np.where(cells.dead, 0.0, share)  # the age of the dead counts from their death
    hint = "Give a column 'radius_um': the size of once quiescent cells does not follow from age."
    given.refuse(share >= 1.0, "age", "is {}, beyond the cycle time of the cell", hint)
    return share
