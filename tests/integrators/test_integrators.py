"""The energy law, growing cells, and what is counted."""

import numpy as np
import pytest
from strategies import cluster, mechanics

from multicell import JKR, Hertz
from multicell.integrators.cvode import Cvode
from multicell.integrators.runge_kutta import Euler
from multicell.integrators.stepping import furthest_move

TIGHT = Cvode(rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("method", [Cvode(), Cvode(rtol=1e-8, atol=1e-5), Euler(5.0)])
@pytest.mark.parametrize("law", [Hertz(), JKR(surface_energy=0.1)])
def test_energy_never_rises_without_growth(method, law):
    position, radius, young = cluster(150, 4, spacing=0.75)
    energies = []
    for _ in range(25):
        system = mechanics(radius, young, law, duration=30.0)
        outcome = method.integrate(system, position)
        assert outcome.done
        position = outcome.position
        energies.append(system.energy(30.0, position))
    scale = max(map(abs, energies))
    # a step may wobble by its tolerance; the law itself only ever goes down
    slack = 1e-12 if isinstance(method, Euler) else method.atol * 1e-2
    assert (np.diff(energies) <= slack * scale).all()
    assert energies[-1] < energies[0]


def test_work_is_counted():
    position, radius, young = cluster(50, 7)
    system = mechanics(radius, young, duration=50.0)
    Euler(1.0).integrate(system, position)
    assert (system.work.steps, system.work.evaluations, system.work.jacobian_products) == (
        50,
        50,
        0,
    )
    system = mechanics(radius, young, duration=50.0, viscosity=0.05)
    Cvode(each_cell=False).integrate(system, position)
    work = system.work
    assert work.evaluations >= work.steps > 1
    assert work.jacobian_products > 0
    assert work.preconditioner_solves > 0
    assert work.rejections == 0


def test_furthest_counts_what_is_no_number_as_infinite():
    before = np.zeros((3, 3))
    after = np.array([[1.0, 0, 0], [np.nan, 0, 0], [2.0, 0, 0]])
    assert furthest_move(before, after, np.ones(3)) == (1, np.inf)
    assert furthest_move(before, after[[0, 2, 2]], np.full(3, 2.0)) == (1, 1.0)
