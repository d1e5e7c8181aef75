"""Deaths in a coupling step expose the cells that are left, in the same step and at their times."""

from types import SimpleNamespace

import numpy as np
import pde
import pytest

from multicell import Scene, Simulation
from multicell.biology.exposure import Exposure, course_with_deaths
from multicell.nutrient.equations.equation import FieldEquation
from multicell.nutrient.equations.substance import Substance
from multicell.random import Purpose, thresholds

STEPS = (40.0, 20.0, 10.0)  # min
# a dose that begins, is largest and ends at times that are multiples of no step
DOSE = [["0.713 h", "0 mM"], ["2.05 h", "3 uM"], ["3.377 h", "0 mM"]]
HILL = {"signal": "drug", "law": "hill", "half": "1 uM", "power": 2}


def shielding(regime, step, **parts):
    """Return cells that keep a drug from each other, and die of it by a rate."""
    drug = {
        "boundary": 0, "uptake": "0.6 amol/s", "half_saturation": "5e-4 mM", "geometry": "radial",
        "diffusion": "50 um^2/s", "media": DOSE, "media_change": "linear", "regime": regime,
    }  # fmt: skip
    return Scene.from_dict({
        "duration": "4 h", "coupling_step": f"{step} min", "seed": 3, "contact": {"law": "hertz"},
        "initial": {"count": 40, "spacing": 1.5}, "output": {"every": "4 h"}, "death": {},
        "nutrients": {"drug": drug},
        "responses": [{"behaviour": "necrosis rate", "largest": "0.6 1/h", **HILL},
                      {"behaviour": "damage rate", "largest": "0.01 1/h", **HILL}],
        **parts,
    })  # fmt: skip


def finished(scene):
    simulation = Simulation(scene, threads=1)
    while not simulation.finished:
        simulation.step()
    return simulation


@pytest.mark.sample("steady-still", "steady-growing")
@pytest.mark.parametrize("growth", [None, {"cycle_time": "30 h"}], ids=["still", "growing"])
@pytest.mark.parametrize("regime", ["steady", "transient"])
def test_damage_hazards_and_survivors_are_of_second_order(regime, growth):
    found = []
    for step in (*STEPS, 2.5):
        simulation = finished(shielding(regime, step, growth=growth))
        cells = simulation.cells
        assert simulation.ledger["drug"].relative_remainder < 1e-8
        found.append([cells.damage.sum(), cells.necrosis_hazard.sum(), cells.dead.sum()])
    *coarse, (damage, hazard, dead) = np.array(found)
    assert 10 < dead < 30
    for column, true in ((0, damage), (1, hazard)):
        errors = np.abs(np.array(coarse)[:, column] / true - 1.0)
        assert errors[-1] < 4e-3
        if errors.max() > 1e-3:  # else only the tolerance of the transient field is left
            assert np.polyfit(np.log(STEPS), np.log(errors), 1)[0] > 1.7
    assert abs(coarse[0][2] - dead) <= 2
    assert abs(coarse[-1][2] - dead) <= 1


@pytest.mark.parametrize("regime", ["steady", "transient"])
def test_what_kills_ends_with_the_cell(regime):
    """The integral of a hazard is the cell's own threshold where it died, at any step."""
    simulation = finished(shielding(regime, 40.0))
    cells, dead = simulation.cells, simulation.cells.dead
    own = thresholds(3, Purpose.NECROSIS, 0, cells.id)
    np.testing.assert_allclose(cells.necrosis_hazard[dead], own[dead], rtol=5e-3)
    assert (cells.necrosis_hazard[~dead] < own[~dead]).all()
    # damage has the same course, and a sixtieth of its size
    np.testing.assert_allclose(cells.damage * 60.0, cells.necrosis_hazard, rtol=1e-9)


def test_an_integral_comes_to_a_share_when_it_does():
    """A rate that is zero until the middle of a step, and rises linearly from there on."""
    scene = Scene.from_dict({"duration": "1 h", "initial": {"count": 3}})
    cells = Simulation(scene, threads=1).cells
    at, values = np.array([0.0, 0.5, 1.0]), np.repeat([[0.0], [0.0], [2.0]], 3, axis=1)
    exposure = Exposure(
        cells, {"drug": values[-1]}, 10.0, before={"drug": values[0]}, inner={"drug": (at, values)}
    )

    part = SimpleNamespace(
        needs=frozenset({"drug"}), effect=SimpleNamespace(law=SimpleNamespace(kinks=()))
    )

    def rate(signals, _):
        return np.asarray(signals["drug"])

    np.testing.assert_allclose(exposure.integral((part,), rate), 5.0)
    times = exposure.reached((part,), rate, np.array([0.0, 0.5, 1.0]))
    np.testing.assert_allclose(times, [0.5, 0.75, 1.0])  # the rate of a piece is its mean
    since = exposure.reached((part,), rate, np.array([0.0, 0.5, 1.0]), np.array([0.1, 0.6, 0.8]))
    np.testing.assert_allclose(since, [0.5, 0.8, 1.0])
    exposure.until = 0.75
    assert 0.5 < exposure.integral((part,), rate)[0] < 5.0


def test_deaths_change_a_steady_field_when_they_come():
    first, alone, last = np.array([1.0]), np.array([3.0]), np.array([7.0])
    at, values = course_with_deaths(first, alone, last, np.array([0.25, 1.0, 0.75]))
    there = np.interp([0.0, 0.2, 0.25, 0.26, 0.75, 0.76, 1.0], at, values[:, 0])
    np.testing.assert_allclose(there, [1.0, 1.4, 1.5, 3.52, 4.5, 6.52, 7.0], atol=1e-6)
    many = np.linspace(0.0, 0.99, 1000)
    at, values = course_with_deaths(first, alone, last, many)
    assert len(at) < 70
    # never before they come, and not much later
    comes = np.searchsorted(many, at, side="right") / 1000.0
    share = (values[:, 0] - 1.0 - 2.0 * at) / 4.0
    assert (share <= comes + 1e-12).all()
    assert (share >= comes - 0.04).all()


def test_cells_exchange_until_they_leave():
    """The mean of a time is that part of it for which they are there; without end, what is now."""
    grid = pde.CartesianGrid([(0, 100)] * 3, 10)
    substance = Substance(100.0, 0.1, 0.01, capacity=np.array([2.0]))
    equation = FieldEquation(grid, {"a": substance}, np.full((1, 3), 45.0))
    placed = equation.substances["a"]
    stays, volume = placed.sink.copy(), equation.layout.volumes
    more = np.full((1, 3), 75.0), None, np.array([3.0]), np.array([5.0]), np.array([40.0])
    placed.let_leave(*more)
    for t, dt, part in ((30.0, 10.0, 1.0), (60.0, 40.0, 0.5), (60.0, 10.0, 0.0),
                        (40.0, np.inf, 1.0), (41.0, np.inf, 0.0)):  # fmt: skip
        placed.set_time(t, dt)
        assert float((placed.sink * volume).sum()) == pytest.approx(2.0 + 3.0 * part)
        assert float((placed.secreted * volume).sum()) == pytest.approx(5.0 * part)
        assert (placed.sink >= stays).all()
