"""Soft tissue that collapses: the bound against closed forms and quadrature, and seen in runs."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from law_samples import NAMES
from scipy import integrate, special

import multicell as mc
from multicell.contact.jkr import JKR
from multicell.contact.pair import Pair
from multicell.contact.springs import LinearSpring
from multicell.report.explain.scene import explain
from multicell.scene import packing
from multicell.scene.pairs import type_pairs
from multicell.scene.sizes import birth_radius
from multicell.simulation import Simulation

LAWS = NAMES


def scene(**changes) -> mc.Scene:
    """Return the scene ``growth`` with changes; two underscores stand for a dot."""
    named = {key.replace("__", "."): value for key, value in changes.items()}
    return mc.load_scene("growth").with_changes(named)


def newborn(**changes) -> Pair:
    described = scene(**changes)
    return next(iter(type_pairs(described, birth_radius(described))))[1]


def ratio(**changes) -> float:
    (found,) = packing.strongest_attraction(scene(**changes)).values()
    return found.ratio


def collapse(text: list[str]) -> list[str]:
    return [note for note in text if "collapses" in note]


# --- the bound ------------------------------------------------------------------------------------


@pytest.mark.parametrize("dimensions", [2, 3])
@pytest.mark.parametrize("law", LAWS)
def test_moments_are_the_pair_energy_integrated_over_space(law, dimensions):
    """(repulsion - attraction)/d = ∫U x^(d-1) dx, with the law's own energy, by SciPy."""
    pair = newborn(contact__law=law, cells__young="0.7 kPa")
    repulsion, attraction = packing.force_moments(pair, dimensions)
    reach = 0.0 if law == "exact-jkr" else pair.reach()
    end = pair.rest + reach
    kept = {"rest": pair.rest, "touching": True}
    at_end = float(pair.law.energy(pair.rest - end, pair.modulus, pair.radius, **kept))

    def energy(x):
        own = float(pair.law.energy(pair.rest - x, pair.modulus, pair.radius, **kept))
        return (own - at_end) * x ** (dimensions - 1)

    whole, _ = integrate.quad(energy, 0.0, end, points=[pair.distance()], epsrel=1e-10)
    assert (repulsion - attraction) / dimensions == pytest.approx(
        whole, rel=1e-5, abs=1e-6 * repulsion
    )
    assert attraction == 0.0 if law == "hertz" else attraction > 0.0


@pytest.mark.parametrize(("dimensions", "value"), [(2, 0.3534), (3, 0.2906)])
def test_largest_overlap_of_approximate_jkr(dimensions, value):
    beta = 0.7 * special.beta(3.5, dimensions) / special.beta(2.75, dimensions)
    largest = beta ** (4 / 3)
    assert largest == pytest.approx(value, abs=5e-5)
    # a law with just this overlap is balanced, for cells of any size and stiffness
    for radius, modulus in ((3.0, 0.4), (11.0, 7.0)):
        overlap = largest * 2 * radius
        energy = overlap**1.5 * modulus / (6 * np.pi * np.sqrt(radius / 2))
        pair = Pair(JKR(surface_energy=energy), modulus, radius / 2, 2 * radius)
        repulsion, attraction = packing.force_moments(pair, dimensions)
        assert attraction == pytest.approx(repulsion, rel=1e-5)


@pytest.mark.parametrize(("dimensions", "cutoff"), [(2, 4 / 3), (3, 5 / 4)])
def test_a_linear_spring_collapses_beyond_a_cutoff_of_5_4(dimensions, cutoff):
    """∫U dV = 0 at (d + 2)/(d + 1), by hand."""
    pair = Pair(LinearSpring(cutoff=cutoff), 1.0, 2.0, 8.0)
    repulsion, attraction = packing.force_moments(pair, dimensions)
    assert attraction == pytest.approx(repulsion, rel=1e-10)


def test_densest_packing_is_that_whose_second_neighbours_touch():
    """Counted in lattices with touching second neighbours."""
    half = range(-6, 7)
    fcc = np.array([p for p in itertools.product(half, half, half) if sum(p) % 2 == 0])
    apart = np.unique(np.round(np.linalg.norm(fcc, axis=1), 9))
    assert apart[2] / apart[1] == pytest.approx(np.sqrt(2))
    # one cell of radius half the second distance for each volume of 2
    assert packing.densest(3) == pytest.approx(4 / 3 * np.pi * (apart[2] / 2) ** 3 / 2)
    hexagonal = np.array([(i + 0.5 * j, np.sqrt(0.75) * j) for i in half for j in half])
    apart = np.unique(np.round(np.linalg.norm(hexagonal, axis=1), 9))
    assert packing.densest(2) == pytest.approx(np.pi * (apart[2] / 2) ** 2 / np.sqrt(0.75))


def test_the_bound_by_law_and_dimension():
    assert ratio() < 1.0 < ratio(cells__young="0.8 kPa")
    assert ratio(cells__young="0.86 kPa") < 1.0 < ratio(cells__young="0.85 kPa")
    assert ratio(cells__young="0.64 kPa", dimensions=2) < 1.0
    assert ratio(cells__young="0.63 kPa", dimensions=2) > 1.0
    # the remedies
    exact = {"contact__law": "exact-jkr"}
    assert ratio(cells__young="0.5 kPa", **exact) < 1.0 < ratio(cells__young="0.2 kPa", **exact)
    assert ratio(cells__young="0.5 kPa", contact__surface_energy="0.058 nN/um") < 1.0
    # bonds of receptors and ligands pull too
    bound = {"types__a": {"receptor": [[0, 0], ["5 h", 1]], "ligand": 1.0}}
    assert ratio(adhesion__strength="0.01 kPa", **bound) < 1.0
    assert ratio(adhesion__strength="0.3 kPa", **bound) > 1.0


def test_like_and_unlike_cells():
    """Unlike cells that attract must also bring like ones together."""

    def of(like, unlike):
        both = {"a": {"a": like, "b": unlike}, "b": {"a": unlike, "b": like}}
        types = {f"types__{name}": {"surface_energy": e} for name, e in both.items()}
        return packing.strongest_attraction(scene(**types))

    apart = of(0.15, 0.05)
    assert apart["a-a"].ratio == apart["b-b"].ratio > 1.0 > apart["a-b"].ratio
    assert of(0.05, 0.2)["a-b"].ratio < 1.0 < of(0.05, 0.3)["a-b"].ratio
    same = of(0.1, 0.1)
    assert same["a-a"].ratio == pytest.approx(ratio(), rel=1e-12)
    # as the sum of all pairs is: half of them repel, half attract
    repulsion, attraction = packing.force_moments(newborn(), 3)
    assert same["a-b"].ratio == pytest.approx(attraction / (2 * repulsion - attraction), rel=1e-9)


# --- what is said ---------------------------------------------------------------------------------


def test_explain_warns_of_soft_tissue_and_names_remedies():
    (note,) = collapse(explain(scene(cells__young="0.5 kPa"))["notes"])
    for words in ("stiffer", "smaller surface energy", "smaller contact.cutoff", "exact-jkr"):
        assert words in note, note
    # what it names does, at the bounds
    assert not collapse(explain(scene(cells__young=0.5 * 1.71))["notes"])
    weak = scene(cells__young=0.5, contact__surface_energy=0.0584)
    assert not collapse(explain(weak)["notes"])
    assert collapse(explain(scene(contact__law="linear"))["notes"])


def test_no_built_in_scene_collapses():
    scenes = {name: mc.load_scene(name) for name in mc.scene_names()}
    assert [name for name, one in scenes.items() if packing.packing_notes(one, 1.0)] == []


def test_two_cells_cannot_collapse():
    soft = mc.load_scene("doublet-settle").with_changes({"cells.young": "0.3 kPa"})
    assert not collapse(explain(soft)["notes"])


def settled(**changes) -> Simulation:
    """Return a cluster of newborn cells that has settled."""
    changes = {"initial.count": 120, "duration": "2 h", "coupling_step": "10 min", **changes}
    simulation = Simulation(mc.load_scene("settle").with_changes(changes))
    while not simulation.finished:
        simulation.step()
    return simulation


@pytest.mark.parametrize(
    ("changes", "collapses"),
    [
        ({}, False),
        ({"cells.young": "0.7 kPa"}, True),
        ({"cells.young": "0.5 kPa", "contact.law": "exact-jkr"}, False),
        ({"contact.law": "linear"}, True),
        ({"dimensions": 2, "cells.young": "0.7 kPa"}, False),
        ({"dimensions": 2, "contact.law": "linear"}, True),
    ],
)
def test_runs_collapse_where_the_bound_says_so(changes, collapses):
    simulation = settled(**changes)
    summary = simulation.summary()
    limit = packing.densest(simulation.scene.dimensions)
    assert (summary["packing_ratio"] > limit) == collapses
    assert bool(collapse(explain(simulation.scene)["notes"])) == collapses
    notes = summary.get("notes", [])
    assert any("The tissue has collapsed" in note for note in notes) == collapses
    assert bool(collapse(notes)) == collapses


def test_a_dense_start_is_called_compressed_not_collapsed():
    described = mc.load_scene("settle").with_changes(
        {"initial.spacing": 0.5, "contact.law": "hertz", "duration": "1 s", "coupling_step": 1.0}
    )
    (note,) = Simulation(described).summary()["notes"]
    assert "more than there is space" in note
    assert "are compressed" in note
    assert "collapsed" not in note
