"""Promises of laws by which the volume of one cell grows."""

from __future__ import annotations

import numpy as np

from multicell.behaviours.growth_laws.laws import GrowthLaw
from multicell.cells import FloatArray
from multicell.testing.promises import carry_out_tests, require

_SLOPE = 1e-5  # how far the slope of the volume may be off, of the largest
_VOLUMES, _SHARES = map(np.ravel, np.meshgrid(np.linspace(1.0, 2.0, 11), np.linspace(0.0, 0.1, 6)))
"""Volumes at the beginning, and shares of a cycle by which they end at 2.2 at most."""
_GROWTH_ROUNDING = 1e-9
"""How far volumes and shares of a growth law may be off, relative to the volume at birth."""


def check_growth_law(law: GrowthLaw) -> None:
    """Check a growth law; raise ``AssertionError`` with every requirement that it violates.

    For volumes from birth to division and shares of a cycle up to 1:

    - rates are above zero, volumes and shares are numbers, and arrays keep their shape;
    - a cell that nothing limits comes from birth to twice that volume in one cycle;
    - the share of a cycle is the inverse of the volume after it;
    - two steps one after the other are one step of their sum, and no step changes nothing;
    - the volume changes at the law's rate, and in any unit of volume by the same law.

    Parameters
    ----------
    law
        A law with its parameters, such as ``Bertalanffy(largest=2.2)``
        (:func:`multicell.growth_law`).
    """
    carry_out_tests(GrowthLawTests(), law, type(law).__name__)


class GrowthLawTests:
    """Tests of a growth law; a subclass gives the law by a fixture of pytest.

    Each promise of :func:`check_growth_law` is a test of its own::

        class TestBertalanffy(GrowthLawTests):
            @pytest.fixture
            def law(self):
                return Bertalanffy(largest=2.2)
    """

    def test_rates_and_volumes_are_numbers(self, law: GrowthLaw) -> None:
        """Rates are above zero, volumes and shares numbers, one for each cell."""
        volume, share = _VOLUMES, _SHARES
        rate = law.rate(volume)
        require(np.shape(rate) == volume.shape, "its rates are not one for each volume")
        require(np.isfinite(rate).all(), "its rate is no number at some volume")
        require((rate > 0.0).all(), "its rate is not above zero from birth to division")
        for found in (law.volume_after(volume, share), law.share_at(volume)):
            require(np.shape(found) == volume.shape, "it does not return one number for each cell")
            require(np.isfinite(found).all(), "it returns something that is no number")

    def test_a_cycle_doubles_the_volume(self, law: GrowthLaw) -> None:
        """A cell that nothing limits comes from birth to twice that volume in one cycle."""
        after = law.volume_after(np.ones(1), np.ones(1))
        _same(after, np.full(1, 2.0), "a cycle does not double the volume")

    def test_share_is_the_inverse_of_volume(self, law: GrowthLaw) -> None:
        """The share of a cycle is the inverse of the volume after it."""
        share = np.linspace(0.0, 1.0, 21)
        found = law.share_at(law.volume_after(np.ones(21), share))
        _same(found, share, "its share of a cycle is not the inverse of its volume")

    def test_steps_add_up(self, law: GrowthLaw) -> None:
        """Two steps one after the other are one step of their sum."""
        volume, share = _VOLUMES, _SHARES
        _same(law.volume_after(volume, 0.0 * share), volume, "no time changes its volume")
        halves = law.volume_after(law.volume_after(volume, 0.4 * share), 0.6 * share)
        _same(halves, law.volume_after(volume, share), "two steps are not one of their sum")

    def test_volume_changes_at_the_rate(self, law: GrowthLaw) -> None:
        """The volume changes at the law's rate, in any unit of volume."""
        volume, h = np.linspace(1.0, 2.0, 21), 1e-4
        ends = [law.volume_after(volume, np.full(21, sign * h)) for sign in (-1.0, 1.0)]
        slope, rate = (ends[1] - ends[0]) / (2.0 * h), law.rate(volume)
        off = float(np.abs(slope - rate).max() / np.abs(rate).max())
        require(off <= _SLOPE, f"its volume does not change at its rate: off by {off:.2g} of it")
        birth = 261.8
        after = law.volume_after(volume * birth, np.full(21, 0.1), birth) / birth
        _same(after, law.volume_after(volume, np.full(21, 0.1)), "it depends on the unit of volume")


def _same(found: FloatArray, wanted: FloatArray, problem: str) -> None:
    off = float(np.max(np.abs(np.asarray(found) - wanted)))
    require(off <= _GROWTH_ROUNDING, f"{problem}: off by {off:.2g}")
