"""Cores and other regions of painted tissue: balls, shells, lumps, holes, scatter, pieces."""

import numpy as np
import pytest
from synthetic import BARE, cells_at

import multicell as mc
from multicell.cells import Phase, State
from multicell.population import extents, regions
from multicell.results.frame import Frame
from multicell.results.observable import TissueState
from multicell.results.summary import history_row

R = 100.0
SHIFT = np.array([30.0, -12.0, 0.0])
PARTS = (0.05, 0.1, 0.2, 0.35, 0.5, 0.7, 0.85, 0.95)
BOTH = pytest.mark.parametrize("dimensions", [3, 2])


def tissue(dimensions=3, count=100_000, seed=3):
    """Return points of a uniform ball or disc, and their distances from its centre."""
    rng = np.random.default_rng(seed)
    way = rng.normal(size=(count, 3))
    way[:, dimensions:] = 0.0
    way /= np.linalg.norm(way, axis=1)[:, None]
    position = way * (R * rng.random(count) ** (1.0 / dimensions))[:, None]
    return position, np.linalg.norm(position, axis=1)


def core(position, dead, dimensions=3, alive=0.5):
    cells = cells_at(position + SHIFT, radius=0.5, state=np.where(dead, State.NECROTIC, 0))
    return extents.necrotic_radius(cells, dimensions, alive)


@BOTH
@pytest.mark.parametrize("part", PARTS)
def test_a_ball_of_dead_cells(dimensions, part):
    """Whole, half emptied, emptied, and with a fifth of the other sort within and outside."""
    position, apart = tissue(dimensions, 1_000_000 if part < 0.1 else 100_000)
    edge = part * R
    assert core(position, apart < edge, dimensions) == pytest.approx(edge, rel=0.02)
    kept = apart > 0.5 * edge
    assert core(position[kept], apart[kept] < edge, dimensions) == pytest.approx(edge, rel=0.02)
    kept = apart > edge
    hollow = core(position[kept], np.zeros(kept.sum(), bool), dimensions)
    assert hollow == pytest.approx(edge, rel=0.02, abs=0.6)  # a cell's radius
    chance = np.random.default_rng(4).random(len(apart))
    if part >= 0.1:
        mixed = core(position, chance < np.where(apart < edge, 0.8, 0.2), dimensions)
        assert mixed == pytest.approx(edge, abs=0.02 * R)


@BOTH
@pytest.mark.parametrize("part", [0.1, 0.3, 0.6])
def test_a_core_has_a_centre_of_its_own(dimensions, part):
    """It counts where the tissue's centre is in it, also among scattered dead cells."""
    position, _ = tissue(dimensions)
    scattered = np.random.default_rng(5).random(len(position)) < 0.1
    for away in (0.3, 0.8):
        middle = np.array([0.0, away * part * R, 0.0])
        dead = np.linalg.norm(position - middle, axis=1) < part * R
        assert core(position, dead, dimensions) == pytest.approx(part * R, abs=0.01 * R)
        found = core(position, dead | scattered, dimensions)
        assert found == pytest.approx(part * R, abs=0.02 * R)
    lump = np.linalg.norm(position - [1.3 * part * R, 0.0, 0.0], axis=1) < part * R
    assert core(position, lump, dimensions) == 0.0


@BOTH
@pytest.mark.parametrize("part", [0.0, 0.001, 0.024, 0.1, 0.2])
def test_scattered_dead_cells_are_no_core(dimensions, part):
    for count, seed in ((30, 1), (500, 2), (500, 3), (20_000, 4)):
        position, _ = tissue(dimensions, count, seed)
        dead = np.random.default_rng(seed).random(count) < part
        assert core(position, dead, dimensions) == 0.0
        dead = np.arange(count) == np.argmax(position[:, 0])  # one at the surface
        assert core(position, dead, dimensions) == 0.0


@BOTH
def test_shells_are_no_core(dimensions):
    position, apart = tissue(dimensions)
    for inner, outer in ((30.0, 50.0), (20.0, 40.0), (50.0, 100.0), (80.0, 100.0)):
        assert core(position, (apart > inner) & (apart < outer), dimensions) == 0.0
        both = (apart < 0.6 * inner) | ((apart > inner) & (apart < outer))
        assert core(position, both, dimensions) == pytest.approx(0.6 * inner, rel=0.02)


def test_an_open_gap_is_no_emptied_core():
    """Two pieces, one of them dead, and a sheet of cells in space."""
    position, apart = tissue(count=5000)
    way = np.array([1.3 * R, 0.0, 0.0])
    pieces = np.concatenate([position + way, position - way])
    assert core(pieces, np.zeros(10_000, bool)) == 0.0
    assert core(pieces, np.arange(10_000) < 5000) == 0.0
    assert core(pieces, np.tile(apart < 50.0, 2)) == 0.0
    assert core(position * [1.0, 1.0, 0.0], np.zeros(5000, bool)) == 0.0


def test_the_share_of_living_cells_at_the_border_is_a_convention():
    """The dead share falls as 1 - r/R: half of it is at R/2, a fifth of the living at R/5."""
    position, apart = tissue()
    dead = np.random.default_rng(6).random(len(apart)) < 1.0 - apart / R
    assert core(position, dead) == pytest.approx(0.5 * R, abs=0.02 * R)
    assert core(position, dead, alive=0.2) == pytest.approx(0.2 * R, abs=0.03 * R)
    assert core(position, apart < 40.0, alive=0.0) == pytest.approx(40.0, rel=0.02)
    holed = (apart < 40.0) & (np.argsort(np.argsort(apart)) != 800)  # one of them at 20 um lives
    assert core(position, holed, alive=0.0) == pytest.approx(0.2 * R, rel=0.02)
    assert core(position, holed) == pytest.approx(40.0, rel=0.02)


def test_all_dead_is_the_whole_tissue():
    position, _ = tissue(count=500)
    cells = cells_at(position, radius=5.0, state=State.NECROTIC)
    row = history_row(TissueState(Frame(0.0, 0, cells, {}), BARE))
    assert row["necrotic_radius"] == row["radius"]
    assert row["viable_rim"] == 0.0


def inhibited(position, cycling, state=State.PROLIFERATING, dimensions=3):
    cells = cells_at(position + SHIFT, radius=0.5, state=state)
    cells.phase = np.where(cycling, Phase.S, Phase.G1).astype(np.int8)
    return extents.inhibited_radius(cells, dimensions)


@BOTH
@pytest.mark.parametrize("part", PARTS)
def test_an_inhibited_ball(dimensions, part):
    position, apart = tissue(dimensions, 1_000_000 if part < 0.1 else 100_000)
    cycling = (np.random.default_rng(7).random(len(apart)) < 0.45) & (apart > part * R)
    found = inhibited(position, cycling, dimensions=dimensions)
    assert found == pytest.approx(part * R, abs=0.005 * R)


def test_total_arrest_is_inhibition_of_all():
    """Painted by phase or by state; one cell that cycles near the surface makes little of it."""
    position, apart = tissue(count=500)
    size = extents.Extent(cells_at(position + SHIFT, radius=0.5), 3).radius()
    none = np.zeros(500, bool)
    assert inhibited(position, none) == size
    assert inhibited(position, ~none, State.QUIESCENT) == size
    assert inhibited(position, ~none, State.NECROTIC) == size
    assert inhibited(position, apart == apart.max()) == pytest.approx(size, rel=0.02)
    assert inhibited(position, ~none) == 0.0


def test_what_is_inhibited_has_the_core_in_it():
    """Where the core was emptied, the cells that are left all cycle."""
    position, apart = tissue()
    kept = apart > 60.0
    assert inhibited(position[kept], np.ones(kept.sum(), bool)) == pytest.approx(60.0, rel=0.02)


@pytest.mark.parametrize("part", [0.1, 0.2])
def test_cells_that_rest_here_and_there_inhibit_nothing(part):
    for seed in range(20):
        position, _ = tissue(count=2000, seed=seed)
        random = np.random.default_rng(1000 + seed)
        state = np.where(random.random(2000) < part, State.NECROTIC, State.PROLIFERATING)
        assert inhibited(position, random.random(2000) < 0.5, state) == 0.0


KINDS = (
    "none",
    "ball",
    "shell",
    "ball and shell",
    "shell, and half beyond",
    "scattered",
    "most",
    "mixed",
    "falling",
)


def painted(kind, position, random):
    """Return which cells of a tissue are of a sort: one of several ways to lie in it."""
    apart = np.linalg.norm(position - [4.0, 0.0, 0.0], axis=1)
    chance, rank = random.random(len(apart)), np.argsort(np.argsort(apart))
    return {
        "none": np.zeros(len(apart), bool),
        "ball": apart < 40.0,
        "shell": (apart > 30.0) & (apart < 50.0),
        "ball and shell": (apart < 15.0) | ((apart > 30.0) & (apart < 90.0)),
        "shell, and half beyond": (apart > 35.0) & ((apart < 70.0) | (rank % 41 < 20)),
        "scattered": chance < 0.1,
        "most": chance < 0.7,
        "mixed": chance < np.where(apart < 40.0, 0.8, 0.2),
        "falling": chance < np.clip(1.0 - apart / R, 0.0, 1.0),
    }[kind]


@BOTH
@pytest.mark.parametrize("shape", ["round", "hollow", "two pieces", "grid"])
def test_what_is_not_sorted_changes_no_region(monkeypatch, dimensions, shape):
    """Cells beyond bounds of the scores stay unsorted: as if all were, bit for bit."""
    random = np.random.default_rng(8)
    position, apart = tissue(dimensions, 6000)
    if shape == "hollow":
        position = position[apart > 30.0]
    if shape == "two pieces":
        position[:2500] += [230.0, 0.0, 0.0]
    if shape == "grid":  # many as far away as others, up to rounding
        width = 2.0 * R / (18.0 if dimensions == 3 else 60.0)
        position = np.unique(np.round(position / width), axis=0) * width
    found = {}
    for few, kind in ((few, kind) for kind in KINDS for few in (0, 10**9)):
        monkeypatch.setattr(regions, "_FEW", few)
        random = np.random.default_rng(9)
        cells = cells_at(position + SHIFT, radius=0.5)
        cells.state[painted(kind, 0.7 * position, random)] = State.QUIESCENT
        cells.state[painted(kind, position, random)] = State.NECROTIC
        cells.phase[~painted(kind, position, random) & (random.random(len(cells)) < 0.5)] = Phase.S
        extent = extents.Extent(cells, dimensions)
        found[few] = (extent.dead_core, extent.resting_core, extent.inhibited)
        found[few] += tuple(extent.core(cells.dead, others) for others in (0.0, 0.2, 0.8))
        if few:
            assert found[0] == found[few], kind


def test_a_core_is_found_among_few_sorted_cells(monkeypatch):
    """Of a ball of 4 % of the cells no more than a tenth are sorted."""
    position, apart = tissue()
    sizes, argsort = [], np.argsort
    monkeypatch.setattr(np, "argsort", lambda x, **how: sizes.append(len(x)) or argsort(x, **how))
    assert core(position, apart < 0.35 * R) == pytest.approx(0.35 * R, rel=0.02)
    assert sizes
    assert max(sizes) < 0.1 * len(apart)


ARREST = {
    "oxygen": {"nutrients.oxygen": {"boundary": "0.001 mM", "quiescence": "0.01 mM", "uptake": 0}},
    "crowding": {"growth.critical_pressure": 1e-6},
}


@pytest.mark.parametrize("cause", ARREST)
def test_a_tissue_that_comes_to_rest_is_inhibited_as_a_whole(cause):
    """Cells that were in S, G2 or M divide first; the others stay in G1, or in G0."""
    phases = {"G1": {"duration": "9 h"}, "S": {"duration": "8 h"}, "G2": {"duration": "4 h"},
              "M": {"duration": "1 h"}}  # fmt: skip
    scene = mc.Scene.from_dict(
        {"duration": "16 h", "coupling_step": "30 min", "initial": {"count": 60, "spacing": 0.8},
         "contact": {"law": "hertz"}, "drag": {"viscosity": 1e6}, "growth": {"phases": phases}}
    ).with_changes(ARREST[cause])  # fmt: skip
    history = mc.run(scene, report=False).history
    assert history["inhibited_radius"][-1] == history["radius"][-1]
    assert history["quiescent"][-1] == (history["cells"][-1] if cause == "oxygen" else 0)
