"""States at the start fit the field of the cells: against the equation of a ball with a core."""

import numpy as np
import pytest
from running import finished
from scipy import integrate, optimize

import multicell as mc
from multicell.cells import Phase, State
from multicell.simulation import Simulation

RADIAL = {"nutrients.oxygen.geometry": "radial", "nutrients.oxygen.spacing": "3 um"}


def started(count, scene="spheroid", **changes):
    described = mc.load_scene(scene).with_changes({"initial.count": count, **changes})
    return Simulation(described, threads=1)


def ball(simulation):
    """Return the radius of the tissue, its cells a volume, and the radius of the medium's face."""
    cells = simulation.cells
    diameter = 2.0 * cells.radius.mean()
    density = np.sqrt(2.0) / (simulation.scene.initial.spacing * diameter) ** 3
    field = simulation.fields["oxygen"]
    outer = field.values.shape[0] * field.spacing
    return (3.0 * len(cells) / (4.0 * np.pi * density)) ** (1 / 3), density, outer


def borders(simulation):
    """Solve D (r² c')' / r² = q(c) outwards from the core; return the radii of core and rest."""
    oxygen = simulation.scene.nutrients["oxygen"]
    edge, density, outer = ball(simulation)
    largest = oxygen.uptake * density

    def slope(r, y):
        rate = largest * y[0] / (oxygen.half_saturation + y[0]) if r < edge else 0.0
        if oxygen.quiescence is not None and y[0] < oxygen.quiescence:
            rate *= oxygen.quiescent_uptake
        return [y[1], rate / oxygen.diffusion - 2.0 * y[1] / r]

    def course(core):
        return integrate.solve_ivp(
            slope, (core, outer), [oxygen.necrosis, 0.0], max_step=0.5, rtol=1e-8, atol=1e-12,
        )  # fmt: skip

    def missing(core):
        return course(core).y[0, -1] - oxygen.boundary

    core = optimize.brentq(missing, 1.0, edge - 1.0, xtol=1e-3)
    found = course(core)
    return core, float(np.interp(oxygen.quiescence or 0.0, found.y[0], found.t))


def radius_of(simulation, mask):
    """Return the radius of the ball that holds as many sites of the packing as there are cells."""
    _, density, _ = ball(simulation)
    return (3.0 * mask.sum() / (4.0 * np.pi * density)) ** (1 / 3)


@pytest.mark.parametrize(
    ("count", "changes"),
    [
        (6000, {}),
        (20_000, {}),
        (6000, {"nutrients.oxygen.quiescent_uptake": 1.0}),
        (6000, {"nutrients.oxygen.half_saturation": 1e-4, "nutrients.oxygen.quiescence": 0.0081}),
    ],
)
def test_core_and_resting_layer_are_those_of_the_equation(count, changes):
    """Uptake by Michaelis and Menten, or nearly of order zero, within an unstirred layer."""
    simulation = started(count, **RADIAL, **changes)
    core, rest = borders(simulation)
    state = simulation.cells.state
    dead = state == State.NECROTIC
    layer = 2.0 * simulation.cells.radius.mean() * np.sqrt(2 / 3)  # between planes of the packing
    assert core > 2.0 * layer
    assert radius_of(simulation, dead) == pytest.approx(core, abs=0.5 * layer)
    if "nutrients.oxygen.quiescence" not in changes:
        found = radius_of(simulation, dead | (state == State.QUIESCENT))
        assert found == pytest.approx(rest, abs=0.5 * layer)


@pytest.mark.parametrize("count", [5000, 20_000])
def test_states_fit_the_field_that_they_make(count):
    """Nobody is dead who would have lived; nobody grows who would rest."""
    simulation = started(count)
    state, c = simulation.cells.state, simulation.concentrations["oxygen"]
    oxygen = simulation.scene.nutrients["oxygen"]
    assert c[state != State.NECROTIC].min() >= oxygen.necrosis
    assert c[state == State.PROLIFERATING].min() >= oxygen.quiescence
    # within a layer of cells, over which the concentration rises by some per cent
    assert c[state == State.NECROTIC].max() < 1.1 * oxygen.necrosis
    assert c[state == State.QUIESCENT].max() < 1.1 * oxygen.quiescence
    assert simulation.first_states["unfit"] == 0
    # the account of the field is that of the final states
    report = simulation.field_system.reports["oxygen"]
    active = np.array([1.0, oxygen.quiescent_uptake, 0.0, 0.0])[state]
    taken = (oxygen.uptake * active * c / (oxygen.half_saturation + c)).sum()
    assert report.uptake == pytest.approx(taken, rel=0.02)


def test_a_seeded_ball_has_the_rim_of_a_grown_one():
    """The spheroid that grew from one cell has 51 µm at 7,600 cells."""
    simulation = started(7500, **{"initial.stage": "asynchronous", "duration": "2 h"})
    begin = simulation.summary()
    assert 46.0 < begin["viable_rim"] < 60.0
    assert begin["start"]["necrotic"] == begin["states"]["necrotic"]
    assert any("necrotic" in note for note in begin["notes"])
    finished(simulation)
    assert 46.0 < simulation.summary()["viable_rim"] < begin["viable_rim"] + 1.0


def test_the_start_is_bitwise_the_same_again_and_on_two_threads():
    first, again = started(3000), started(3000)
    both = Simulation(first.scene, threads=2)
    for other in (again, both):
        np.testing.assert_array_equal(first.cells.state, other.cells.state)
        np.testing.assert_array_equal(
            first.concentrations["oxygen"], other.concentrations["oxygen"]
        )


def test_few_cells_that_lack_nothing_need_one_field(monkeypatch):
    from multicell.nutrient.fields import FieldSystem

    calls, begin = [], FieldSystem.begin

    def counted(self, *args, **options):
        calls.append(1)
        begin(self, *args, **options)

    monkeypatch.setattr(FieldSystem, "begin", counted)
    simulation = started(200)
    assert len(calls) == 1
    assert simulation.first_states == {}
    assert "start" not in simulation.summary()
    # searches grow with the logarithm of the number of cells
    started(20_000)
    assert len(calls) < 80


def test_a_field_that_does_not_begin_as_steady_decides_as_it_is():
    changes = {"nutrients.oxygen.regime": "transient"}
    filled = started(4000, **changes)
    assert (filled.cells.state == State.PROLIFERATING).all()
    steady = started(4000, **changes, **{"nutrients.oxygen.initial": "steady"})
    np.testing.assert_array_equal(steady.cells.state, started(4000).cells.state)


def test_two_fields_and_atp():
    """Cells die where the ATP of oxygen and glucose does not do, as the fields then are."""
    changes = {"stop_cells": None, "energy.quiescence": 0.25, "growth.restriction": False,
               "nutrients.oxygen.boundary": 0.05, "nutrients.glucose.boundary": 0.8}  # fmt: skip
    simulation = started(8000, "emt6", **changes)
    scene, state = simulation.scene, simulation.cells.state
    made = scene.energy.supply(scene.nutrients, simulation.concentrations)
    dead = state == State.NECROTIC
    assert 100 < dead.sum() < 7000
    assert made[~dead].min() >= scene.energy.necrosis
    assert made[dead].max() < 1.2 * scene.energy.necrosis
    assert made[state == State.PROLIFERATING].min() >= scene.energy.quiescence


def test_with_a_restriction_point_cells_rest_there():
    phases = {"G1": {"duration": "8 h"}, "S": {"duration": "6 h"}, "G2": {"duration": "3 h"},
              "M": {"duration": "1 h", "grows": False}}  # fmt: skip
    changes = {"growth.phases": phases, "initial.stage": "asynchronous"}
    simulation = started(4000, **changes)
    cells = simulation.cells
    rests = cells.state == State.QUIESCENT
    assert rests.sum() > 500
    assert (cells.phase[rests] == Phase.G0).all()
    birth = 0.5 * 4 / 3 * np.pi * simulation.scene.cells.division_radius**3
    np.testing.assert_allclose(cells.volume[rests], birth * (1 + 8 / 17), rtol=1e-12)
    np.testing.assert_allclose(cells.age[rests], 8 * 3600.0)
    assert (cells.phase[~rests] != Phase.G0).all()


def test_a_rate_of_necrosis_lets_nobody_be_dead_at_the_start():
    simulation = started(8000, **{"death.necrosis_rate": "1 1/h"})
    assert not simulation.cells.dead.any()


def test_given_states_are_kept_and_others_are_found():
    found = started(5000)
    table = found.frame().to_pandas()
    columns = ["position_x_um", "position_y_um", "position_z_um", "radius_um"]
    scene = mc.load_scene("spheroid")
    again = Simulation(scene, cells=table[columns], threads=1)
    np.testing.assert_array_equal(again.cells.state, found.cells.state)
    alive = table[columns].assign(state="quiescent")
    given = Simulation(scene, cells=alive, threads=1)
    assert given.first_states == {}


def test_products_that_kill_are_no_reason_to_search_for_ever():
    """Who dies of a product no longer makes it: what is found is stated, and the search ends."""
    toxin = {"diffusion": "50 um^2/s", "boundary": 0.0, "uptake": 0.0, "secretion": "1 amol/s",
             "necrosis_above": "2e-2 mM", "regime": "steady"}  # fmt: skip
    simulation = started(5000, **{"nutrients.toxin": toxin})
    state, c = simulation.cells.state, simulation.concentrations["toxin"]
    assert simulation.first_states["necrotic"] > 2000, "203 die without the product"
    assert simulation.first_states["unfit"] == (c[state != State.NECROTIC] > 2e-2).sum()


@pytest.mark.slow
def test_a_resumed_run_knows_its_start(tmp_path):
    scene = mc.load_scene("spheroid").with_changes(
        {"initial.count": 5000, "duration": "20 min", "output.every": "10 min"}
    )
    result = mc.run(scene, output=tmp_path / "run", report=False)
    longer = mc.resume(tmp_path / "run", changes={"duration": "40 min"}, report=False)
    whole = mc.run(scene.with_changes({"duration": "40 min"}), report=False)
    assert longer.summary()["start"] == result.summary()["start"] == whole.summary()["start"]
    np.testing.assert_array_equal(longer.frames[-1].cells.state, whole.frames[-1].cells.state)
    np.testing.assert_array_equal(longer.frames[-1].cells.position, whole.frames[-1].cells.position)
