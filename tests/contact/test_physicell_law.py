"""PhysiCell's adhesion and repulsion against the velocities that its papers give."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

import multicell as mc
from multicell.contact.physicell import PhysiCell

VISCOSITY = 5.0


def velocity(d, total, repulsion, adhesion, cutoff):
    """Return what a neighbour adds to a cell's velocity, away from it: µm/min."""
    push = repulsion * (1.0 - d / total) ** 2 if d < total else 0.0
    reach = cutoff * total
    return push - (adhesion * (1.0 - d / reach) ** 2 if d < reach else 0.0)


def law_of(adhesion, cutoff):
    """Return the law with an adhesion in µm/min."""
    return PhysiCell(surface_energy=3.0 * np.pi * VISCOSITY * adhesion / 60.0, cutoff=cutoff)


@pytest.mark.parametrize(
    ("repulsion", "adhesion", "cutoff"), [(10.0, 0.4, 1.25), (50.0, 0.0, 1.25), (20.0, 5.0, 2.5)]
)
def test_cells_of_one_size_move_as_in_physicell(repulsion, adhesion, cutoff):
    law, modulus = law_of(adhesion, cutoff), 3.0 * np.pi * VISCOSITY * repulsion / 60.0
    for radius in (4.0, 8.4):
        for d in np.linspace(0.1, 3.0 * radius * cutoff, 40):
            force = float(law.force(2.0 * radius - d, modulus, 0.5 * radius, rest=2.0 * radius))
            moved = 60.0 * force / (6.0 * np.pi * VISCOSITY * radius)
            expected = velocity(d, 2.0 * radius, repulsion, adhesion, cutoff)
            assert moved == pytest.approx(expected, rel=1e-12, abs=1e-14)


@pytest.mark.parametrize("law", [PhysiCell(), law_of(5.0, 2.5), law_of(0.0, 1.25)])
def test_slopes_energies_and_distances_at_rest(law):
    modulus, radius = 16.0, 4.2
    rest = 4.0 * radius
    end = -float(law.reach(modulus, radius, rest=rest))
    force = lambda h: float(law.force(h, modulus, radius, rest=rest))  # noqa: E731
    for h in (0.7 * end, 0.3, 2.0):
        slope = (force(h + 1e-5) - force(h - 1e-5)) / 2e-5
        assert float(law.stiffness(h, modulus, radius, rest=rest)) == pytest.approx(slope, rel=1e-6)
        work = quad(force, end, h, points=[0.0])[0]
        assert float(law.energy(h, modulus, radius, rest=rest)) == pytest.approx(work, abs=1e-9)
    assert force(1.001 * end - 1e-9) == 0.0
    found = float(law.equilibrium_overlap(modulus, radius))
    if law.surface_energy == 0.0:
        assert found == 0.0
    else:
        assert found == pytest.approx(brentq(force, 1e-9, rest - 1e-9), rel=1e-9)


def test_cells_that_attract_more_than_they_repel_do_not_rest():
    law = PhysiCell(surface_energy=20.0)
    assert float(law.equilibrium_overlap(10.0, 4.0)) == 16.0
    assert float(law.force(15.0, 10.0, 4.0, rest=16.0)) < 0.0


def test_a_range_below_first_contact_is_refused():
    with pytest.raises(mc.SceneError, match=r"cutoff: is 0\.9, must be"):
        PhysiCell(cutoff=0.9)
