"""Orders, and errors over tolerances, of all methods against an independent solution."""

import numpy as np
import pytest
from oracles import exact_end, four_cells, reference
from strategies import cluster, mechanics

from multicell import JKR, Hertz
from multicell.integrators.base import build_method
from multicell.integrators.cvode import Cvode
from multicell.integrators.registry import METHODS, find
from multicell.integrators.rkc import Rkc2
from multicell.integrators.runge_kutta import Dopri5, RungeKutta4

pytestmark = pytest.mark.kernels

LAWS = [Hertz(), JKR(surface_energy=0.1)]
HALVED = np.array([1.0, 0.5, 0.25, 0.125])
LONGEST = {"ab2": 4.0, "rk4": 10.0}
# its steps grow in number like 1 / tolerance
FINEST = {"euler-adaptive": 5, "multirate-euler": 5}
FIXED = [*(name for name, info in METHODS.items() if info.control == "step"), "rkc2-5"]
ADAPTIVE = [name for name, info in METHODS.items() if info.control == "tolerance"]
law_names = ["hertz", "jkr"]


def error_of(method, law, duration=200.0):
    position, radius, young = four_cells()
    outcome = method.integrate(mechanics(radius, young, law, duration=duration), position)
    assert outcome.done
    assert outcome.time == duration
    return np.abs(outcome.position - exact_end(four_cells, law, duration)).max()


@pytest.mark.parametrize("law", LAWS, ids=law_names)
@pytest.mark.parametrize("name", FIXED)
def test_order(name, law):
    info = find(name)
    steps = HALVED * LONGEST.get(name, 4.0 if info.order == 1 else 8.0)
    errors = [
        error_of(build_method(info, step=step, atol=1e-6, max_displacement=0.5), law)
        for step in steps
    ]
    slope = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert slope == pytest.approx(info.order, abs=0.15)


@pytest.mark.parametrize("law", LAWS, ids=law_names)
def test_order_of_rkc2_with_as_many_stages_as_it_needs(law):
    steps = 8.0 * HALVED
    errors = [error_of(Rkc2(step=step), law) for step in steps]
    assert np.polyfit(np.log(steps), np.log(errors), 1)[0] == pytest.approx(2.0, abs=0.15)


@pytest.mark.parametrize("law", LAWS, ids=law_names)
@pytest.mark.parametrize("name", ADAPTIVE)
def test_the_error_follows_the_tolerance(name, law):
    tolerances = 10.0 ** -np.arange(3.0, FINEST.get(name, 9) + 1.0)
    options = {"max_steps": 10**7, "max_displacement": 0.5}
    methods = [build_method(METHODS[name], rtol=t, atol=t, **options) for t in tolerances]
    ratio = np.array([error_of(method, law) for method in methods]) / tolerances
    assert (ratio < 100.0).all()
    typical = np.exp(np.log(ratio).mean())
    assert (ratio < 30.0 * typical).all()
    assert (ratio > typical / 30.0).all()


@pytest.mark.parametrize("law", LAWS, ids=law_names)
@pytest.mark.parametrize("method", [RungeKutta4(0.5), Dopri5(1e-10, 1e-10), Cvode(1e-13, 1e-12)])
def test_high_orders_meet_the_reference(method, law):
    assert error_of(method, law) < 2e-9


@pytest.mark.parametrize("name", ADAPTIVE)
def test_a_tolerance_is_met_where_contacts_form_and_break(name):
    position, radius, young = cluster(40, 6, spacing=0.85)
    exact = reference(mechanics(radius, young, Hertz()), position, 1e-10)
    for atol in (1e-2, 1e-4):
        method = build_method(
            METHODS[name], rtol=1e-12, atol=atol, max_steps=10**6, max_displacement=0.5
        )
        found = method.integrate(mechanics(radius, young, Hertz()), position)
        assert np.abs(found.position - exact).max() < 30 * atol
