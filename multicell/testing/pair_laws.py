"""Promises of laws of the force between two cells."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from multicell.contact.law import PairLaw, effective_modulus, effective_radius
from multicell.mechanics.motion import Motion
from multicell.mechanics.system import Mechanics
from multicell.testing.integrators import TRIED_BEGIN, TRIED_END
from multicell.testing.promises import carry_out_tests, require

_SIZES = (2.0, 5.0, 8.0)  # radii r_ij at which laws are tried, µm: small to large cells
_MODULI = (0.2, 1.0, 5.0)  # moduli E_ij at which laws are tried, kPa
_PAIRS = [(e, 0.5 * r, 2.0 * r) for e in _MODULI for r in _SIZES]
"""E_ij, r_ij and the sum of the radii of some pairs of equal cells."""
_SLOPE = 1e-5
"""How far slopes may be off, of the largest."""


def check_pair_law(law: PairLaw) -> None:
    """Check a pair law; raise ``AssertionError`` with every requirement that it violates.

    Pairs of three sizes and three moduli are taken through overlaps from beyond the reach to
    nine tenths of a radius:

    - force, stiffness and energy are numbers, and zero where the law does not act;
    - the force is the slope of the energy and the stiffness that of the force, away from
      kinks: to 1e-5 of the largest, by central differences;
    - the reach is at least zero, falls neither with the radius nor with the sum of the radii, and
      does not rise with the modulus;
    - at the equilibrium overlap the force vanishes;
    - compiled, two cells have the force, energy and stiffness that the law's function gives;
    - the forces in a cluster of all sizes are those of the law's function over all its pairs;
    - a law with the same parameters is equal to it.

    Parameters
    ----------
    law
        A law with its parameters, such as ``Cubic(stiffness=2.0)``.
    """
    carry_out_tests(PairLawTests(), law, type(law).__name__)


class PairLawTests:
    """Tests of a pair law; a subclass gives the law by a fixture of pytest.

    Each promise of :func:`check_pair_law` is a test of its own::

        class TestSquare(PairLawTests):
            @pytest.fixture(params=[0.5, 2.0])
            def law(self, request):
                return Square(stiffness=request.param)
    """

    def test_force_and_stiffness_are_slopes(self, law: PairLaw) -> None:
        """Force and stiffness are numbers, slopes, and zero beyond the reach."""
        for modulus, radius, rest in _PAIRS:
            begin = -float(law.reach(modulus, radius, rest=rest))
            overlap = np.linspace(begin - 0.1 * rest, 0.45 * rest, 301)
            dh = 1e-6 * rest
            low, here, high = (
                np.stack(law.evaluate(overlap + s * dh, modulus, radius, rest=rest, touching=True))
                for s in (-1.0, 0.0, 1.0)
            )
            at = f"at E = {modulus:g} kPa and r = {radius:g} um"
            require(np.isfinite(here).all(), f"{at} it gives something that is no number")
            require(
                not here[:, overlap < begin - dh].any(),
                f"{at} it acts beyond its reach of {-begin:g} um",
            )
            # where it begins to act and where adhesion sets in a law may have a kink
            smooth = np.minimum(np.abs(overlap - begin), np.abs(overlap)) > 0.02 * rest
            found = (high - low)[[2, 0]] / (2.0 * dh)
            names = ("force", "energy"), ("stiffness", "force")
            for (name, of), slope, claimed in zip(names, found, here[:2], strict=True):
                off = float(np.abs(slope - claimed)[smooth].max())
                most = float(np.abs(claimed).max())
                problem = f"its {name} is not the slope of the {of}: off by {off:.2g} of {most:.2g}"
                require(off <= _SLOPE * most, f"{at} {problem}")

    def test_reach_is_monotonic(self, law: PairLaw) -> None:
        """The reach bounds that of pairs of other sizes and moduli."""
        grid = np.array(
            [
                [[float(law.reach(e, r, rest=4.0 * r * s)) for s in (1.0, 2.0)] for r in _SIZES]
                for e in _MODULI
            ]
        )
        require((grid >= 0.0).all(), "its reach is below zero")
        require((np.diff(grid, axis=0) <= 0.0).all(), "its reach rises with the modulus")
        require((np.diff(grid, axis=1) >= 0.0).all(), "its reach falls with the radius")
        require((np.diff(grid, axis=2) >= 0.0).all(), "its reach falls with the sum of the radii")

    def test_rest_is_without_force(self, law: PairLaw) -> None:
        """At the equilibrium overlap the force vanishes."""
        for modulus, radius, rest in _PAIRS:
            overlap = float(law.equilibrium_overlap(modulus, radius))
            around = np.linspace(overlap, max(1.1 * overlap, 0.1 * rest), 9)
            force = law.evaluate(around, modulus, radius, rest=rest, touching=True)[0]
            small = 1e-6 * float(np.abs(force).max())
            problem = f"at its equilibrium overlap of {overlap:.3g} um the force is"
            kept = abs(float(force[0])) <= small or overlap >= rest
            require(kept, f"{problem} {float(force[0]):.2g} nN")

    def test_compiled_law_is_the_function(self, law: PairLaw) -> None:
        """Kernels give two cells what the law's function gives."""
        rest, poisson = 10.0, 0.5
        modulus = float(effective_modulus(1.0, poisson, 1.0, poisson))
        for overlap in (0.02, 0.3, 1.5, 4.0):
            system, ones, touching = Mechanics(law, 5.0), np.ones(2), np.array([[0, 1]])
            motion = (5.0 * ones, 0.0 * ones, ones, poisson * ones, TRIED_BEGIN, TRIED_END)
            system.begin(Motion(*motion, touching=touching))
            position = np.array([[0.0, 0.0, 0.0], [rest - overlap, 0.0, 0.0]])
            wanted = law.evaluate(overlap, modulus, 2.5, rest=rest, touching=True)
            v, out = np.array([[0.0, 0.0, 0.0], [-1.0, 0.0, 0.0]]), np.empty((2, 3))
            system.linearise(TRIED_BEGIN, position)
            system.jacobian_product(v, out)
            found = {
                "force": float(system.force(TRIED_BEGIN, position)[1, 0]),
                "stiffness": float(out[1, 0]) * system.drag * 5.0,
                "energy": system.energy(TRIED_BEGIN, position),
            }
            for (name, got), value in zip(found.items(), wanted, strict=True):
                kept = math.isclose(got, float(value), rel_tol=1e-9, abs_tol=1e-12)
                at = f"its {name} at an overlap of {overlap:g} um"
                require(kept, f"compiled, {at} is {got!r}, not {value!r}")

    def test_no_pair_of_a_cluster_is_missed(self, law: PairLaw) -> None:
        """Forces in a cluster of all sizes are those of the law's function over all pairs."""
        rng = np.random.default_rng(5)
        place, poisson = 9.0 * rng.random((10, 3)), 0.5
        radius, young = rng.uniform(1.5, 4.0, 10), rng.uniform(0.5, 2.0, 10)
        first, second = np.triu_indices(10, 1)
        way = place[first] - place[second]
        distance, rest = np.linalg.norm(way, axis=1), radius[first] + radius[second]
        near = distance < rest
        system, ones = Mechanics(law, 5.0), np.ones(10)
        motion = (radius, 0.0 * ones, young, poisson * ones, TRIED_BEGIN, TRIED_END)
        system.begin(Motion(*motion, touching=np.stack([first, second], axis=1)[near]))
        found = system.force(TRIED_BEGIN, place)
        modulus = effective_modulus(young[first], poisson, young[second], poisson)
        size = effective_radius(radius[first], radius[second])
        force = law.evaluate(rest - distance, modulus, size, rest=rest, touching=near)[0]
        pushes, wanted = np.asarray(force)[:, None] * way / distance[:, None], np.zeros((10, 3))
        np.add.at(wanted, first, pushes)
        np.add.at(wanted, second, -pushes)
        off, most = float(np.abs(found - wanted).max()), float(np.abs(wanted).max())
        # a law in lengths of its own may act nowhere here: then kernels must not either
        problem = "forces in a cluster are not those of all its pairs"
        require(off <= 1e-9 * most, f"{problem}: off by {off:.2g} of {most:.2g} nN")

    def test_law_is_a_value(self, law: PairLaw) -> None:
        """A law with the same parameters is equal to it, and counts as the same key."""
        same = replace(law)  # type: ignore[type-var]
        require(same == law, "a law with the same parameters is not equal to it")
        require(hash(same) == hash(law), "a law with the same parameters has another hash")
