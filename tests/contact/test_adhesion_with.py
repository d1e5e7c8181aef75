"""Adhesion by pairs of types for any law: closed forms, sums over pairs, bits, refusals."""

import numpy as np
import pytest
from formulas import Pairs, product_of, slope, velocity_of
from running import refused
from scipy.integrate import quad
from scipy.optimize import brentq
from strategies import cluster

import multicell as mc
from multicell.contact.springs import CubicSpring, LinearSpring
from multicell.mechanics.motion import Motion
from multicell.mechanics.system import Mechanics
from multicell.report.explain.scene import explain
from multicell.scene.pairs import law_by_types, type_pairs
from multicell.scene.scene import Scene
from multicell.simulation.assembly import mechanics_of

FACTORS = {"a": {"a": 1.0, "b": 0.1}, "b": {"b": 2.5}}
MATRIX = np.array([[1.0, 0.1], [0.1, 2.5]])
RADIUS, RANGE = 5.0, 5.0


def scene_of(contact, factors=None, **parts):
    rows = FACTORS if factors is None else factors
    kinds = {name: {"fraction": 0.5, "adhesion_with": row} for name, row in rows.items()}
    return Scene.from_dict({"duration": 60.0, "contact": contact, "types": kinds} | parts)


@mc.pair_law(parameters={"k": "nN/um"}, reach=lambda modulus, radius, rest, p: 0.4 * rest)
def early(overlap, modulus, radius, p, rest):
    """Rest at an overlap of half a micrometre."""
    x = 1.0 + overlap / (0.4 * rest)
    return p.k * (overlap - 0.5) * x * x


@mc.pair_law(parameters={"k": "nN/um"})
def wavy(overlap, modulus, radius, p):
    return p.k * (overlap - 1.0) * (overlap - 2.0)


# -- closed forms of pairs


def test_springs_rest_as_before_and_pull_by_the_factor():
    scene = scene_of({"law": "cubic", "stiffness_at_rest": 1.5})
    pairs = dict(type_pairs(scene, RADIUS))
    for name, factor in {"a-a": 1.0, "a-b": 0.1, "b-b": 2.5}.items():
        assert pairs[name].distance() == pytest.approx(2.0 * RADIUS, rel=1e-12)
        force, overlap = pairs[name].deepest()
        assert force == pytest.approx(factor * 4.0 / 27.0 * 1.5 * RANGE, rel=1e-9)
        assert overlap == pytest.approx(-RANGE / 3.0, rel=1e-4)


def test_jkr_has_the_surface_energy_of_the_pair():
    scene = scene_of({"law": "jkr", "surface_energy": 0.04})
    law, entries = law_by_types(scene)
    assert law == scene.contact
    np.testing.assert_allclose(entries, 0.04 * MATRIX, rtol=1e-15)
    for pair, factor in zip(dict(type_pairs(scene, RADIUS)).values(), (1.0, 0.1, 2.5), strict=True):
        sigma = 0.04 * factor
        overlap = (6.0 * np.pi * sigma * np.sqrt(pair.radius) / pair.modulus) ** (2.0 / 3.0)
        assert pair.equilibrium_overlap() == pytest.approx(overlap, rel=1e-12)
        assert pair.deepest()[0] == pytest.approx(1.5 * np.pi * sigma * pair.radius, rel=1e-9)


def test_a_law_of_ones_own_keeps_its_rest_and_its_energy_is_the_integral():
    law = early(k=1.2)
    scaled = law.scaled_by_pairs().for_pair(0.3)

    def force(h):
        found = 1.2 * (h - 0.5) * (1.0 + h / 4.0) ** 2 * (h > -4.0)
        return found if found > 0.0 else 0.3 * found

    assert brentq(force, 0.1, 1.0) == pytest.approx(
        float(scaled.equilibrium_overlap(1.0, 2.5)), rel=1e-9
    )
    for h in (-4.5, -3.0, -1.0, 0.4, 0.7, 2.0):
        got, _, energy = scaled.evaluate(h, 1.0, 2.5, rest=10.0)
        assert float(got) == pytest.approx(force(h), abs=1e-12)
        exact = quad(force, -4.0, max(h, -4.0), points=[min(0.5, h)], epsabs=1e-12)[0]
        assert float(energy) == pytest.approx(exact, rel=1e-9, abs=1e-11)


# -- populations


def system(law, radius, young, **options):
    n = len(radius)
    made = Mechanics(law, 5.0, **options)
    kind = np.random.default_rng(3).integers(0, 2, n)
    made.begin(Motion(radius, np.zeros(n), young, np.full(n, 0.5), 0.0, 10.0, kind=kind))
    return made, kind


@pytest.mark.slow
@pytest.mark.kernels
def test_sums_over_pairs_and_their_derivative():
    law = CubicSpring(stiffness_at_rest=1.2).scaled_by_pairs()
    position, radius, young = cluster(60, 8, spacing=0.95, variation=0.2)
    made, kind = system(law, radius, young, pair_table=MATRIX)
    pairs = Pairs(position, radius, young, law, sigma=MATRIX[np.ix_(kind, kind)])
    plain = Pairs(position, radius, young, CubicSpring(stiffness_at_rest=1.2))
    expected = pairs.forces()
    assert np.abs(expected - plain.forces()).max() > 0.1 * np.abs(expected).max()
    np.testing.assert_allclose(
        made.force(0.0, position), expected, atol=1e-10 * np.abs(expected).max()
    )
    assert made.energy(0.0, position) == pytest.approx(pairs.energy.sum(), rel=1e-10)
    direction = np.random.default_rng(1).normal(size=position.shape)
    made.linearise(0.0, position)
    exact = slope(velocity_of(made), position, direction, 1e-6)
    np.testing.assert_allclose(product_of(made, direction), exact, atol=1e-6 * np.abs(exact).max())
    # all factors 1: the law itself, bit for bit
    same, _ = system(law, radius, young, pair_table=np.ones((2, 2)))
    own, _ = system(CubicSpring(stiffness_at_rest=1.2), radius, young)
    assert np.array_equal(same.force(0.0, position), own.force(0.0, position))
    np.testing.assert_array_equal(same.neighbours.reach, own.neighbours.reach)


@pytest.mark.slow
@pytest.mark.kernels
@pytest.mark.parametrize(("factors", "least", "most"), [
    ({"a": {"b": 0.1}, "b": {}}, 0.0, 0.2), ({"a": {}, "b": {}}, 0.4, 0.7),
], ids=["unlike cells pull a tenth", "all alike"])  # fmt: skip
def test_springs_sort_cells_that_wander(factors, least, most):
    """The part of contacts between unlike cells in the last three of twelve hours."""
    scene = scene_of(
        {"law": "cubic", "stiffness_at_rest": 0.4}, factors, duration=43200.0, dimensions=2,
        coupling_step=600.0, initial={"count": 60, "spacing": 1.0}, drag={"viscosity": 0.5},
        motility={"diffusion": 0.006}, integrator={"method": "euler-adaptive", "atol": 0.2},
        output={"every": 43200.0},
    )  # fmt: skip
    unlike = mc.run(scene).history["heterotypic_fraction"]
    assert 0.4 < np.nanmean(unlike[1:3]) < 0.7
    assert least <= np.nanmean(unlike[-18:]) <= most


def test_scenes_without_factors_have_the_law_itself():
    scene = scene_of({"law": "cubic"}, {"a": {}, "b": {}})
    made = mechanics_of(scene, 1)
    assert made.law is scene.contact
    assert made.pair_table is None
    made = mechanics_of(scene_of({"law": "cubic"}), 1)
    np.testing.assert_array_equal(made.pair_table, MATRIX)


def test_explain_names_the_factors_and_the_pull_of_each_pair():
    words = str(explain(scene_of({"law": "linear"})))
    assert "adhesion of some types times 0.1 to 2.5" in words


# -- refusals


@pytest.mark.parametrize(("contact", "factors", "path", "words"), [
    ({"law": "hertz"}, FACTORS, "types.a.adhesion_with", "attracts nowhere"),
    ({"law": "none"}, FACTORS, "types.a.adhesion_with", "attracts nowhere"),
    ({"law": "jkr", "surface_energy": 0}, FACTORS, "types.a.adhesion_with", "attracts nowhere"),
    ({"law": "linear", "cutoff": 1}, FACTORS, "types.a.adhesion_with", "attracts nowhere"),
    (wavy(k=1.0), FACTORS, "types.a.adhesion_with", "repels at an overlap"),
    ({"law": "cubic"}, {"a": {"c": 1}}, "types.a.adhesion_with.c", "not a type of this scene"),
    ({"law": "cubic"}, {"a": {"b": 1}, "b": {"a": 2}}, "types.a.adhesion_with.b",
     "is 1, but types.b.adhesion_with.a is 2"),
    ({"law": "cubic"}, {"a": {"a": -1}}, "types.a.adhesion_with.a", "at least 0"),
])  # fmt: skip
def test_factors_that_mean_nothing(contact, factors, path, words):
    with refused(path, words):
        scene_of(contact, factors)


def test_factors_beside_surface_energies():
    with refused("types.a.adhesion_with", "surface energies of types"):
        kinds = {"a": {"surface_energy": {"a": 0.1}, "adhesion_with": {"a": 2}}}
        Scene.from_dict({"duration": 60.0, "contact": {"law": "jkr"}, "types": kinds})


def test_only_laws_that_attract_without_a_surface_energy_are_scaled():
    assert mc.JKR().scaled_by_pairs() is None
    assert mc.Hertz().scaled_by_pairs() is None
    assert LinearSpring(cutoff=1.0).scaled_by_pairs() is None
    assert LinearSpring().scaled_by_pairs() is not None
