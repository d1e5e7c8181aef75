"""Uptake and secretion of cells: Michaelis-Menten, by volume, by type and state."""

import numpy as np
import pytest
from numba import njit
from running import refused

import multicell as mc
from multicell.cells import SPHERE, State
from multicell.errors import SceneError
from multicell.nutrient import balls
from multicell.nutrient.fields import FieldSystem
from multicell.nutrient.uptake import balanced, rate, uptake, uptake_and_slope
from multicell.population.extents import Extent
from multicell.report.explain.course import expected_course
from multicell.scene.scales import scales
from multicell.scene.scene import Scene


def scene(nutrient, types=None, **changes):
    entries = {
        "duration": "30 min", "coupling_step": "10 min", "contact": {"law": "hertz"},
        "initial": {"count": 60, "stage": "asynchronous"}, "growth": {"cycle_time": "15 h"},
        "types": types or {}, "nutrients": {"a": nutrient},
    }  # fmt: skip
    return Scene.from_dict(entries | changes)


# --- Michaelis-Menten: its derivative by complex step, and its balance ----------------------------


@njit
def compiled(most, c, half):
    """Return the arguments of a kernel."""
    return uptake_and_slope(most, c, half)


def test_slope_is_the_derivative():
    c = np.logspace(-6, 2, 50)
    taken, slope = uptake_and_slope(3.0, c, 0.02)
    np.testing.assert_allclose(taken, 3.0 * c / (0.02 + c), rtol=1e-14)
    step = 1e-30
    exact = (3.0 * (c + 1j * step) / (0.02 + c + 1j * step)).imag / step
    np.testing.assert_allclose(slope, exact, rtol=1e-12)
    np.testing.assert_array_equal(uptake(3.0, c, 0.02), taken)
    np.testing.assert_allclose(rate(3.0, c, 0.02) * c, taken, rtol=1e-15)


def test_below_zero_it_goes_on_along_its_tangent():
    c = np.array([-2.0, -1e-9, -0.0, 0.0])
    taken, slope = uptake_and_slope(3.0, c, 0.02)
    np.testing.assert_allclose(slope, 150.0)
    np.testing.assert_allclose(taken, 150.0 * c)


@pytest.mark.parametrize("c", [-0.3, 0.0, 1e-9, 0.02, 7.0])
def test_kernels_and_arrays_get_the_same_bits(c):
    here, slope = uptake_and_slope(np.array([3.0]), np.array([c]), 0.02)
    assert compiled(3.0, c, 0.02) == (here[0], slope[0])


@pytest.mark.parametrize("c", [-0.5, -1e-12, 0.0, 1e-15, 1e-3, 0.02, 5.0, 1e6])
@pytest.mark.parametrize("loss", [1e-8, 1.0, 1e8])
def test_balance_is_met(c, loss):
    most, half = 3.0, 0.02
    taken, _ = uptake_and_slope(most, c, half)
    assert balanced(loss * c + taken, loss, most, half) == pytest.approx(c, rel=1e-9, abs=1e-18)


# --- in proportion to volume ----------------------------------------------------------------------


def test_a_cell_takes_up_in_proportion_to_its_volume():
    described = scene({"uptake_per_volume": "0.02 amol/s/um^3"})
    cells = mc.Simulation(described).cells
    assert np.ptp(cells.volume) > 0.5 * cells.volume.min()
    capacity, production = FieldSystem(described).demand("a", cells)
    assert production is None
    np.testing.assert_allclose(capacity, 0.02 * SPHERE * cells.radius**3, rtol=1e-14)


@pytest.mark.parametrize("radius", [5.0, 10.0])
def test_a_ball_has_the_field_of_the_closed_form_whatever_its_cells_size(radius):
    """Uptake Q in all, saturated, in a ball of radius R behind a layer that ends at L.

    At its surface c = c0 - Q/(4 π D) (1/R - 1/L), on average within Q/(20 π D R) less.
    """
    diffusion, most = 1000.0, 0.05
    described = scene(
        {
            "uptake_per_volume": most, "half_saturation": "1e-9 mM", "diffusion": diffusion,
            "boundary": "0.2 mM", "layer": "40 um", "spacing": "2 um", "geometry": "radial",
        },
        initial={"count": round(8000 * (5.0 / radius) ** 3)}, growth=None,
        cells={"division_radius": radius},
    )  # fmt: skip
    simulation = mc.Simulation(described)
    cells = simulation.cells
    ball = 0.5 * Extent(cells, 3).diameter()
    taken = most * float(cells.volume.sum())
    surface = 0.2 - taken / (4.0 * np.pi * diffusion) * (1.0 / ball - 1.0 / (ball + 40.0))
    field = simulation.frame().fields["a"]
    there = np.interp(ball, field.axis(0) - field.origin[0], field.values.ravel())
    # the larger the cells, the rougher the surface, and the more of them lies beyond R
    assert there == pytest.approx(surface, abs=1e-3 * (radius - 3.0) * (0.2 - surface))
    inside = surface - float(simulation.concentrations["a"].mean())
    assert inside == pytest.approx(taken / (20.0 * np.pi * diffusion * ball), rel=0.06)
    assert simulation.ledger["a"].relative_remainder < 1e-8


@pytest.mark.parametrize("geometry", ["radial", "box"])
def test_cells_are_placed_once_a_step(monkeypatch, geometry):
    """Also where some die, and all is solved for again; the row of the history places none."""
    death = {"apoptosis_rate": "0.3 1/h", "apoptosis_time": "5 h", "removal_fraction": 0.1}
    field = {"uptake": "60 amol/s", "diffusion": "1750 um^2/s", "geometry": geometry,
             "spacing": "10 um", "margin": "40 um", "quiescence": "0.01 mM"}  # fmt: skip
    simulation = mc.Simulation(scene(field, death=death), threads=1)
    counts = {"placed": 0}

    def counting(function):
        def counted(*given):
            counts["placed"] += 1
            return function(*given)

        return counted

    monkeypatch.setattr(balls.OnShells, "at", counting(balls.OnShells.at))
    monkeypatch.setattr(balls, "placed", counting(balls.placed))
    for _ in range(3):
        counts["placed"], dead = 0, simulation.cells.dead.sum()
        simulation.step()
        cells = simulation.state.cells
        assert cells.dead.sum() > dead
        simulation.history_row()
        assert counts["placed"] == 1
        assert_uptake_is_that_of_all_cells(simulation)
    simulation.cells.radius *= 1.1
    assert_uptake_is_that_of_all_cells(simulation)
    simulation.cells.position *= 0.9
    assert_uptake_is_that_of_all_cells(simulation)


def assert_uptake_is_that_of_all_cells(simulation):
    cells, system = simulation.state.cells, simulation.field_system
    capacity, _ = system.demand("a", cells)
    taken = system.fields["a"].uptake(cells.position.copy(), capacity, cells.radius)
    assert simulation.history_row()["uptake_a"] == taken.sum() > 0.0


def test_demand_and_forecast_are_those_of_the_same_uptake_of_typical_cells():
    by_volume = scene({"uptake_per_volume": 0.02, "necrosis": "0.01 mM"}, duration="4 d")
    assert scales(by_volume, "a").demand == pytest.approx(0.02, rel=1e-12)
    assert np.isfinite(expected_course(by_volume).cells).all()


def test_one_of_the_two_uptakes_only():
    with refused("nutrients.a.uptake_per_volume", "given both"):
        scene({"uptake": 20.0, "uptake_per_volume": 0.02})
    with pytest.raises(SceneError, match="change of concentration"):
        scene({"uptake_per_volume": "20 amol/s"})
    changed = scene({}).with_changes(
        {"nutrients.a.uptake": None, "nutrients.a.uptake_per_volume": "72 mM/h"}
    )
    assert changed.nutrients["a"].uptake_per_volume == pytest.approx(0.02)
    assert changed.nutrients["a"].uptake is None


def test_no_uptake_by_volume_is_no_uptake():
    none = {"uptake_per_volume": 0.0, "uptake_on": {"b": {"effect": 1, "half": 1}}}
    with pytest.raises(SceneError, match="uptake is zero"):
        Scene.from_dict({"duration": "1 h", "nutrients": {"b": {}, "a": none}})


# --- by type and state ----------------------------------------------------------------------------

BOTH = {"uptake": 10.0, "secretion": 3.0}


def demand(described):
    """Return cells in all states, and what the fields take as their demand."""
    cells = mc.Simulation(described).cells.copy()
    cells.state = np.resize(np.array(State, dtype=cells.state.dtype), len(cells))
    return cells, *FieldSystem(described).demand("a", cells)


def test_without_factors_secretion_goes_with_uptake():
    described = scene({**BOTH, "quiescent_uptake": 0.3}, {"x": {}, "y": {"uptake_scale": 2.0}})
    cells, uptake, secretion = demand(described)
    expected = np.array([1.0, 0.3, 0.0, 0.0])[cells.state] * np.array([1.0, 2.0])[cells.kind]
    np.testing.assert_array_equal(uptake, 10.0 * expected)
    np.testing.assert_array_equal(secretion, 3.0 * expected)


def test_each_factor_has_its_effect_on_one_of_the_two():
    types = {
        "x": {"uptake_scale": 2.0, "secretion_scale": 5.0, "uptake_of": {"a": 3.0}},
        "y": {"uptake_scale": 0.5, "secretion_of": {"a": 7.0}},
    }
    cells, uptake, secretion = demand(scene({**BOTH, "quiescent_uptake": 0.3}, types))
    assert len(set(zip(cells.kind.tolist(), cells.state.tolist(), strict=True))) == 8
    active = np.array([1.0, 0.3, 0.0, 0.0])[cells.state]
    np.testing.assert_allclose(uptake, 10.0 * active * np.array([6.0, 0.5])[cells.kind], rtol=1e-14)
    given = 3.0 * active * np.array([5.0, 3.5])[cells.kind]
    np.testing.assert_allclose(secretion, given, rtol=1e-14)


def test_a_run_accounts_for_what_its_cells_give():
    nutrient = {"secretion": 3.0, "uptake": 0.0, "regime": "transient"}
    simulation = mc.Simulation(scene(nutrient, {"x": {"secretion_scale": 0.5}}))
    lived = 0.0
    while not simulation.finished:
        known, free = len(simulation.cells), simulation.next_id
        simulation.step()
        # two daughters give where their mother gave until they were born, an age ago
        born = simulation.cells.id >= free
        lived += 600.0 * known + 0.5 * simulation.cells.age[born].sum()
    given = 3.0 * 0.5 * lived
    ledger = simulation.ledger["a"]
    assert ledger.secreted == pytest.approx(given, rel=1e-12)
    assert ledger.relative_remainder <= 1e-8


@pytest.mark.parametrize(
    ("name", "factor", "words"), [("b", 1.0, "not a field"), ("a", -1.0, "at least 0")]
)
def test_refused_in_words(name, factor, words):
    with refused(f"types.x.uptake_of.{name}", words):
        scene({}, {"x": {"uptake_of": {name: factor}}})
