"""Rest overlaps of bonded pairs against SciPy's root finder."""

import math

import numpy as np
import pytest
from scipy.optimize import brentq

from multicell.contact.pair import rest_overlap
from multicell.contact.registry import LAWS

MODULUS, RADIUS, REST = 1.0, 2.5, 10.0
BONDS = np.array([0.0, 1e-6, 1e-3, 0.03, 0.1])


@pytest.mark.parametrize("name", list(LAWS))
def test_the_forces_cancel_there(name):
    law = LAWS[name]()
    found = rest_overlap(law, MODULUS, RADIUS, REST, BONDS)

    def net(overlap, bonds):
        force = law.evaluate(overlap, MODULUS, RADIUS, rest=REST, touching=True)[0]
        return float(force) - math.pi * RADIUS * bonds * overlap

    without = float(law.equilibrium_overlap(MODULUS, RADIUS))
    assert found[0] == pytest.approx(without, abs=1e-12)
    for bonds, overlap in zip(BONDS[1:], found[1:], strict=True):
        low, high = max(without, 1e-12), 0.999 * REST
        bound = net(low, bonds) < 0.0  # a spring stiffer than its bonds rests without overlap
        if net(high, bonds) < 0.0:
            exact = (
                1.0 - 1e-9
            ) * REST  # a repulsion that stays finite cannot keep the centres apart
        else:
            exact = brentq(net, low, high, (bonds,), 1e-14, 1e-14) if bound else without
        assert overlap == pytest.approx(exact, rel=1e-9, abs=1e-9)
    assert (np.diff(found) >= -1e-12).all()
