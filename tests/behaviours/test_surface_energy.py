"""The surface energy of contacts by a response: forces, places at rest, and what is refused."""

import numpy as np
import pytest

import multicell as mc
from multicell.errors import SceneError
from multicell.mechanics.motion import Motion
from multicell.mechanics.system import Mechanics
from multicell.scene.responses import largest_factor

SURFACE = "surface energy"


def motion(factors):
    two = np.ones(2)
    kind = np.array([0, 1], dtype=np.int16)
    touching = np.array([[0, 1]])
    return Motion(
        5.0 * two, 0.0 * two, two, 0.4 * two, 0.0, 1.0, kind=kind, touching=touching, sticky=factors
    )


def forces(law, factors, overlaps, energies=None):
    """Return the force on the second of two cells along the line of centres, nN."""
    system = Mechanics(law, 1.0, pair_table=energies)
    found = []
    for overlap in overlaps:
        system.begin(motion(factors))
        position = np.array([[0.0, 0.0, 0.0], [10.0 - overlap, 0.0, 0.0]])
        out = np.empty((2, 3))
        system.velocity(0.0, position, out)
        found.append(out[1, 0] * system.drag * 5.0)
    return np.array(found)


@pytest.mark.parametrize("name", ["jkr", "exact-jkr", "physicell"])
@pytest.mark.parametrize("factors", [(2.0, 2.0), (0.5, 2.0), (0.3, 1.7)])
def test_force_is_that_of_a_law_with_the_mean_energy(name, factors):
    scene = mc.Scene.from_dict({"duration": "1 h", "contact": {"law": name}})
    law, mean = scene.contact, float(np.sqrt(factors[0] * factors[1]))
    overlaps = np.linspace(-0.2, 4.0, 18)
    found = forces(law, np.array(factors), overlaps)
    wanted = law.for_pair(mean * law.surface_energy)
    exact = forces(wanted, None, overlaps)
    np.testing.assert_allclose(found, exact, rtol=1e-12, atol=1e-15)
    assert exact.min() < 0.0


@pytest.mark.slow
def test_pull_off_is_that_of_exact_jkr():
    """It is 3/2 π w r with the work of adhesion w = σ √(f g), whatever the cells' stiffness."""
    law = mc.Scene.from_dict({"duration": "1 h", "contact": {"law": "exact-jkr"}}).contact
    overlaps = np.linspace(-3.0, 1.0, 8001)
    for factors in [(1.0, 1.0), (0.25, 1.0), (2.0, 0.5)]:
        found = forces(law, np.array(factors), overlaps).min()
        wanted = -1.5 * np.pi * law.surface_energy * np.sqrt(factors[0] * factors[1]) * 2.5
        assert found == pytest.approx(wanted, rel=1e-4)


def test_of_types_the_energy_of_their_pair_is_scaled():
    law = mc.Scene.from_dict({"duration": "1 h", "contact": {"law": "jkr"}}).contact
    energies, overlaps = np.array([[0.1, 0.02], [0.02, 0.3]]), np.linspace(0.0, 1.0, 5)
    found = forces(law, np.array([4.0, 1.0]), overlaps, energies)
    wanted = forces(law.for_pair(0.04), None, overlaps)
    np.testing.assert_allclose(found, wanted, rtol=1e-12)


def test_cells_that_do_not_stick_are_those_of_hertz():
    law = mc.Scene.from_dict({"duration": "1 h", "contact": {"law": "jkr"}}).contact
    hertz = mc.Scene.from_dict({"duration": "1 h", "contact": {"law": "hertz"}}).contact
    overlaps = np.linspace(0.0, 1.0, 5)
    found = forces(law, np.array([0.0, 3.0]), overlaps)
    np.testing.assert_allclose(found, forces(hertz, None, overlaps), rtol=1e-12)


def scene(response, **changes):
    return mc.Scene.from_dict(
        {
            "duration": "30 h",
            "contact": {"law": "jkr", "surface_energy": 0.1},
            "cells": {"young_variation": 0.0},
            "initial": {"count": 2, "shape": "row", "spacing": 0.9},
            "responses": {"stick": {"behaviour": SURFACE, **response}},
            **changes,
        }
    )


@pytest.mark.parametrize("factor", [0.4, 1.3])
def test_two_cells_come_to_rest_where_the_closed_form_has_them(factor):
    """h₀ = (6πσ √r_ij / E_ij)^(2/3), with σ times the factor."""
    made = scene({"law": "constant", "largest": factor})
    cells = mc.run(made).frames[-1].cells
    overlap = cells.radius.sum() - np.linalg.norm(cells.position[0] - cells.position[1])
    young, poisson = made.cells.young, made.cells.poisson
    modulus = 4.0 / 3.0 / (2.0 * (1.0 - poisson**2) / young)
    ratio = 6.0 * np.pi * 0.1 * factor * np.sqrt(cells.radius[0] / 2.0) / modulus
    assert overlap == pytest.approx(ratio ** (2.0 / 3.0), rel=1e-2)  # tolerance of the integrator


def test_a_signal_changes_it_in_time():
    """Nothing sticks from 10 h on: cells that were drawn together part to where they touch."""
    loose = {"signal": "time", "law": "threshold", "half": "10 h", "base": 1, "largest": 0}
    frames = mc.run(scene(loose, output={"every": "10 h"})).frames
    gaps = [
        np.linalg.norm(f.cells.position[0] - f.cells.position[1]) - f.cells.radius.sum()
        for f in frames
    ]
    assert gaps[1] < -1.0
    assert -0.3 < gaps[-1] <= 0.0


@pytest.mark.parametrize(
    ("contact", "response", "path"),
    [
        ({"law": "hertz"}, {"law": "constant", "largest": 2}, "behaviour"),
        ({"law": "jkr", "surface_energy": 0.0}, {"law": "constant", "largest": 2}, "behaviour"),
        ({"law": "jkr"}, {"law": "constant", "largest": 500}, "draws cells"),
        ({"law": "jkr"}, {"law": "constant", "largest": 2000}, "largest"),
    ],
)
def test_what_cannot_be_is_refused(contact, response, path):
    with pytest.raises(SceneError, match=rf"responses\.stick.*{path}"):
        scene(response, contact=contact)


def test_the_largest_factor_of_several_responses():
    two = {
        "one": {"behaviour": SURFACE, "signal": "pressure", "half": 1.0, "base": 1, "largest": 3},
        "two": {
            "behaviour": SURFACE,
            "signal": "time",
            "law": "table",
            "points": [[0, 0.5], ["1 h", 2.0]],
        },
    }
    for rule, wanted in (("product", 6.0), ("maximum", 3.0), ("sum", 4.0)):
        rules = {name: {**part, "combine": rule} for name, part in two.items()}
        made = mc.Scene.from_dict(
            {"duration": "1 h", "contact": {"surface_energy": 0.01}, "responses": rules}
        )
        assert largest_factor(made, SURFACE) == (wanted, "responses.one")
    assert largest_factor(made, "speed") == (1.0, "")
