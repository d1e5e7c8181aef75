"""Every observable of the registry in painted tissue: none, one, all, scattered, hollow, pieces."""

import math
from dataclasses import dataclass

import numpy as np
import pytest
from synthetic import cells_at

import multicell as mc
from multicell.cells import Cells, Phase, State
from multicell.results.frame import Frame
from multicell.results.measures import OBSERVABLES
from multicell.results.observable import TissueState

EDGE, CELL, LOW, HIGH, PRESSURE = 50.0, 0.4, 0.002, 0.06, 0.05  # µm, µm, mM, mM, kPa
COUNT = 6000
NAN = float("nan")


def uniform(dimensions, count=COUNT, seed=2):
    rng = np.random.default_rng(seed)
    way = rng.normal(size=(count, 3))
    way[:, dimensions:] = 0.0
    way /= np.linalg.norm(way, axis=1)[:, None]
    return way * (EDGE * rng.random(count) ** (1.0 / dimensions))[:, None]


@dataclass
class Painted:
    """A tissue, which of its cells are dead, hypoxic and at rest, and the radius within which."""

    position: np.ndarray
    marked: np.ndarray
    core: float
    dimensions: int = 3

    @property
    def radius(self):
        """By the moments of the bodies, (d + 2)/d times the mean square distance."""
        if len(self.position) == 0:
            return 0.0
        share = self.dimensions / (self.dimensions + 2)
        away = self.position - self.position.mean(axis=0)
        return math.sqrt((np.square(away).sum(axis=1).mean() + share * CELL**2) / share)


def painted():
    ball, disc = uniform(3), uniform(2)
    apart = np.linalg.norm(ball, axis=1)
    none, every = np.zeros(COUNT, bool), np.ones(COUNT, bool)
    scattered = np.random.default_rng(3).random(COUNT) < 0.2
    whole = Painted(ball, every, 0.0).radius
    kept, way = apart > 30.0, np.array([1.2 * EDGE, 0.0, 0.0])
    pieces = np.concatenate([0.4 * (ball + way), 0.4 * (ball - way)])
    return {
        "none": Painted(np.zeros((0, 3)), np.zeros(0, bool), 0.0),
        "one living": Painted(np.zeros((1, 3)), np.zeros(1, bool), 0.0),
        "one dead": Painted(np.zeros((1, 3)), np.ones(1, bool), CELL),
        "all living": Painted(ball, none, 0.0),
        "all": Painted(ball, every, whole),
        "a core": Painted(ball, apart < 30.0, 30.0),
        "scattered": Painted(ball, scattered, 0.0),
        "one of many": Painted(ball, np.arange(COUNT) == 7, 0.0),
        "a shell": Painted(ball, apart > 30.0, 0.0),
        "hollow": Painted(ball[kept], none[kept], 30.0),
        "two pieces": Painted(pieces, np.repeat([True, False], COUNT), 0.0),
        "a disc": Painted(disc, np.linalg.norm(disc, axis=1) < 30.0, 30.0, 2),
        "a plane in space": Painted(disc, none, 0.0),
    }


CASES = painted()
FEW = {"duration": "20 min", "coupling_step": "10 min", "initial": {"count": 5}, "death": {}}
PHASES = {"G1": {"duration": "9 h"}, "S": {"duration": "8 h"}, "G2": {"duration": "4 h"},
          "M": {"duration": "1 h"}}  # fmt: skip
MEASURED = [o for o in OBSERVABLES if o.measure is not None]
OF_A_CORE = ("viable_rim", "proliferating_rim", "necrotic_radius", "necrotic_ratio",
             "inhibited_radius", "inhibited_ratio", "hypoxic_radius_*")  # fmt: skip
FULL = {**FEW, "growth": {"phases": PHASES, "critical_pressure": 0.1, "ki67_decay": "1 h"},
        "types": {"soft": {"young": 0.5}, "stiff": {"young": 2.0}},
        "radiation": {"course": {"dose": "2 Gy", "times": ["10 min"], "alpha": "0.3 1/Gy",
                                 "mitotic_divisions": 1}},
        "nutrients": {"oxygen": {"boundary": 0.07, "uptake": 0}}}  # fmt: skip
BOX = {**FEW, "domain": {axis: [-60.0, 60.0] for axis in "xyz"}}
GEL = {**FEW, "domain": {"shape": "sphere", "radius": "60 um", "stiffness": "10 kPa"}}
PULLED = {**FEW, "initial": {"count": 2, "spacing": 0.95}, "pull": {"force": 1.0, "rate": 0.01}}


@mc.network(states={"A": 1.0})
def still(t, y, u, p, out):
    """A state that nothing changes."""
    out[0] = 0.0


NETWORKED = {**FEW, "networks": {"still": {"network": still}}}
SCENES = {
    **{f"network_{x}_*": NETWORKED for x in ("mean", "low", "high")}, "volume_fraction": BOX,
    "wall_pressure": BOX, "tissue_pressure": BOX, "domain_radius": GEL, "pull": PULLED,
}  # fmt: skip


def scene_of(name, dimensions):
    if dimensions == 2 and SCENES.get(name) in (BOX, GEL):
        return None
    return mc.Scene.from_dict({**SCENES.get(name, FULL), "dimensions": dimensions})


def expected(name, case, key):
    """Return the value of an observable in a painted tissue, by the definition of its name."""
    n, dead, size = len(case.position), int(case.marked.sum()), case.radius
    living, alive = n - dead, np.flatnonzero(~case.marked)
    rim = size - case.core if case.core else NAN
    inhibited = case.core if living else size
    volume = 4.0 / 3.0 * math.pi * n * CELL**3 / 120.0**3
    known = {
        "cells": n, "radius": size, "diameter": 2.0 * size,
        "viable_rim": rim, "proliferating_rim": rim, "growth_fraction": 1.0 if living else NAN,
        "necrotic_radius": case.core, "necrotic_ratio": case.core / size if n else NAN,
        "inhibited_radius": inhibited, "inhibited_ratio": inhibited / size if n else NAN,
        "hypoxic_radius_*": case.core,
        "packing_ratio": n * (CELL / size) ** case.dimensions if n else NAN,
        "largest_pressure": PRESSURE if n else 0.0,
        "proliferating": living, "quiescent": 0, "necrotic": dead, "apoptotic": 0,
        "clonogens": int((alive % 3 > 0).sum()), "doomed": int((alive % 3 == 0).sum()),
        "volume_fraction": volume, "tissue_pressure": PRESSURE * volume, "wall_pressure": 0.0,
        "domain_radius": 60.0, "pressure_factor": 0.5 if living else NAN,
        "ki67_positive": 1.0 if living else NAN, "contacts": max(n - 1, 0),
        "heterotypic_fraction": 1.0 if n > 1 else NAN,
        "network_mean_*": alive.mean() if living else NAN,
        "network_low_*": np.quantile(alive, 0.05) if living else NAN,
        "network_high_*": np.quantile(alive, 0.95) if living else NAN,
        "living_*": int((alive % 2 == (key == "stiff")).sum()), "pull": 1.0,
    }  # fmt: skip
    return known[name]


def frame_of(case):
    """Return the state: the living cycle, every third cell is doomed, types take turns.

    Networks hold the number of the cell.
    """
    n = len(case.position)
    cells = Cells.empty()
    if n:
        state = np.where(case.marked, State.NECROTIC, State.PROLIFERATING)
        cells = cells_at(case.position, CELL, state, PRESSURE)
        cells.phase = np.full(n, Phase.S, np.int8)
        cells.doomed = (np.arange(n) % 3 == 0).astype(np.int8)
        cells.kind = (np.arange(n) % 2).astype(np.int16)
        cells.inside = np.repeat(np.arange(n, dtype=float)[:, None], 9, axis=1)
    chain = np.column_stack([np.arange(n), np.arange(n) + 1])[: max(n - 1, 0)]
    found = {"oxygen": np.where(case.marked, LOW, HIGH)}
    return Frame(0.0, 0, cells, found, contacts=chain)


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("ours", MEASURED, ids=lambda ours: ours.name)
def test_every_observable_in_painted_tissue(ours, case):
    paint = CASES[case]
    scene = scene_of(ours.name, paint.dimensions)
    if scene is None:
        pytest.skip("walls are in space")
    state = TissueState(frame_of(paint), scene)
    keys = ours.keys(scene)
    assert keys
    for key in keys:
        wanted = expected(ours.name, paint, key)
        exact = paint.core in (0.0, paint.radius) or ours.name not in OF_A_CORE
        within = 1e-9 if exact else 0.02 * (1.0 if ours.name.endswith("ratio") else paint.core)
        assert ours.value(state, key) == pytest.approx(wanted, abs=within, nan_ok=True)
