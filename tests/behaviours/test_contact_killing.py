"""Killing by contact: a rate for each touching cell of a type, against its closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial import KDTree

import multicell as mc

SIDE, SHARE = 30, 0.4  # cells along a side; part of them that kill
PER_CONTACT, HOURS = 0.15, 4.0  # 1/h, h


def mixture():
    """Return a sheet in closest packing of two types at random, and who touches whom."""
    row, column = np.divmod(np.arange(SIDE**2), SIDE)
    place = 9.5 * np.stack([column + 0.5 * (row % 2), row * math.sqrt(0.75)], axis=1)
    killer = np.random.default_rng(4).random(len(place)) < SHARE
    pairs = KDTree(place).query_pairs(9.9, output_type="ndarray")
    touching = np.zeros(len(place), int)
    np.add.at(touching, pairs[:, 0], killer[pairs[:, 1]])
    np.add.at(touching, pairs[:, 1], killer[pairs[:, 0]])
    inner = np.bincount(pairs.ravel(), minlength=len(place)) == 6
    return place, killer, touching, inner


@pytest.fixture(scope="module")
def run():
    """Return who was alive at the end of a sheet that does not move."""
    place, killer, *_ = mixture()
    scene = mc.Scene(duration=f"{HOURS:g} h", dimensions=2, coupling_step="20 min", seed=2)
    scene = scene.with_changes(
        {
            "types.killer": {},
            "types.target": {},
            "drag.viscosity": "1e6 kPa s",  # nobody moves
            "growth.cycle_time": "1e5 h",
            "death.apoptosis_time": "1e5 h",  # the dead keep their place
            "responses.contact": {
                "cells": "target",
                "behaviour": "apoptosis rate",
                "signal": "contacts with killer",
                "law": "linear",
                "begin": 0,
                "end": 10,
                "largest": f"{10 * PER_CONTACT} 1/h",
            },
        }
    )
    cells = {
        "x / um": place[:, 0],
        "y / um": place[:, 1],
        "radius / um": np.full(len(place), 4.9),
        "type": np.where(killer, "killer", "target").astype(object),
    }
    end = mc.run(scene, cells=cells, threads=1).frames[-1].cells
    return end.state[np.argsort(end.id)] != int(mc.State.APOPTOTIC)


def test_survivors_are_those_of_the_killers_that_each_touches(run):
    """Expected: Σ exp(-k n t) over the targets, n the killers that a target touches."""
    _, killer, touching, _ = mixture()
    chance = np.exp(-PER_CONTACT * HOURS * touching[~killer])
    spread = math.sqrt((chance * (1.0 - chance)).sum())
    assert abs(run[~killer].sum() - chance.sum()) < 3.5 * spread
    assert run[killer].all()
    alone = ~killer & (touching == 0)
    assert alone.sum() > 10
    assert run[alone].all()


def test_a_well_mixed_pair_has_the_closed_form_of_its_fraction(run):
    """With z neighbours of which a part f kills: (1 - f + f exp(-k t))^z of the targets live."""
    _, killer, _, inner = mixture()
    targets = inner & ~killer
    share = killer.mean()
    wanted = (1.0 - share + share * math.exp(-PER_CONTACT * HOURS)) ** 6
    spread = math.sqrt(wanted * (1.0 - wanted) / targets.sum())
    assert abs(run[targets].mean() - wanted) < 4.0 * spread
    assert 0.1 < wanted < 0.5  # neither all nor none
