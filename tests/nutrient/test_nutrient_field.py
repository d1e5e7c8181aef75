"""The nutrient field: laying, keeping and moving its grid, and what it gives to the cells."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pde import ScalarField
from plain_pde import uncompiled

from multicell.errors import MulticellError, NutrientFailed, SceneError
from multicell.nutrient.cartesian import extent, lay
from multicell.nutrient.diffusion import Diffusion
from multicell.nutrient.equations.grid import grid_on
from multicell.nutrient.field import NutrientField
from multicell.nutrient.parameters import FieldParameters
from multicell.nutrient.tissue import Tissue
from multicell.scene.nutrient import Nutrient, Side
from multicell.scene.scales import MAX_NODES

OXYGEN = {
    "diffusion": 2000.0,
    "boundary": 0.07,
    "half_saturation": 0.005,
    "spacing": 10.0,
    "margin": 50.0,
}


def oxygen(**changes):
    nutrient = Nutrient(**{**OXYGEN, **changes})
    return NutrientField(
        "oxygen", FieldParameters(nutrient, nutrient.spacing, 10.0, "steady", dimensions=3)
    )


def ball(radius, seed=0, centre=(0.0, 0.0, 0.0)):
    """Return the centres of cells of 5 µm packed at random in a ball, and their uptake."""
    rng = np.random.default_rng(seed)
    n = max(1, int(0.64 * (radius / 5.0) ** 3))
    direction = rng.normal(size=(n, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    position = direction * radius * rng.random((n, 1)) ** (1 / 3) + np.asarray(centre)
    return position, np.full(n, 20.0)


coordinate = st.floats(-2000.0, 2000.0)


@given(
    st.lists(st.tuples(coordinate, coordinate, coordinate), min_size=1, max_size=10),
    st.floats(50.0, 100.0),
    st.floats(1.0, 100.0),
)
def test_a_box_covers_all_cells_and_the_margin_and_is_exact_along_its_longest_axis(
    rows, spacing, margin
):
    low, high = extent(np.array(rows), margin)
    box = lay(low, high, spacing)
    assert box.spacing <= spacing * (1 + 1e-12)
    room = np.array([low - box.origin, np.array(box.upper) - high])
    longest = int((high - low).argmax())
    assert np.all(room > -1e-9)
    np.testing.assert_allclose(room[:, longest], 0.0, atol=1e-9)
    np.testing.assert_allclose(room[0], room[1], atol=1e-9)
    assert box.nodes == np.prod(box.shape)


def test_supply_does_not_jump_while_a_spheroid_grows():
    """The layer of medium stays as thick as the margin, though the nodes become more."""
    field, scale = oxygen(), np.linspace(1.0, 1.3, 61)
    position, capacity = ball(90.0)
    centre, shapes = [], set()
    for s in scale:
        field.solve(s * position, s**3 * capacity)
        shapes.add(field.layout.box.shape)
        centre.append(field.sample(np.zeros((1, 3)))[0])
    assert len(shapes) >= 3
    change = np.diff(centre)
    assert (change < 0).all()
    assert np.abs(np.diff(change)).max() < 0.01 * (max(centre) - min(centre))


def test_the_uptake_of_the_cells_adds_up_to_the_uptake_of_the_field():
    """Per cell it is the mean of c / (K + c) over its nodes' weights: the gather's transpose."""
    field = oxygen()
    position, capacity = ball(100.0)
    report = field.solve(position, capacity)
    values = field.field().values
    ratio = values / (0.005 + values)
    there = ScalarField(grid_on(field.layout), ratio)
    with uncompiled():
        of_cells = capacity * there.interpolate(position)
    assert of_cells.sum() == pytest.approx(report.uptake, rel=1e-12)


def test_far_from_one_cell_the_field_is_that_of_a_point_sink():
    """Differences between a cell's neighbourhoods: c(r2) - c(r1) = q / (4 pi D) (1/r1 - 1/r2)."""
    field = oxygen(margin=400.0, half_saturation=1e-6, spacing=10.0)
    field.solve(np.array([[1.0, 2.0, 3.0]]), np.array([20.0]))
    a, b = 80.0, 160.0
    directions = np.vstack([np.eye(3), -np.eye(3)])
    near, far = (field.sample(directions * r + [1.0, 2.0, 3.0]).mean() for r in (a, b))
    exact = 20.0 / (4 * np.pi * 2000.0) * (1 / a - 1 / b)
    assert far - near == pytest.approx(exact, rel=0.02)


def test_the_grid_follows_cells_that_move_away_and_shrinks_again():
    field = oxygen()
    field.solve(*ball(120.0))
    big = field.layout.box.nodes
    field.solve(*ball(40.0, centre=(500.0, -300.0, 0.0)))
    assert field.layout.box.nodes < 0.5 * big
    middle = 0.5 * (np.array(field.layout.box.origin) + field.layout.box.upper)
    np.testing.assert_allclose(middle, [500.0, -300.0, 0.0], atol=15.0)


def test_a_new_grid_starts_from_the_old_field():
    position, capacity = ball(150.0)
    cold, warm = oxygen(), oxygen()
    warm.solve(position, capacity)
    larger = 1.02 * position
    reports = cold.solve(larger, capacity), warm.solve(larger, capacity)
    assert warm.layout.box == cold.layout.box
    assert reports[1].cg < reports[0].cg


def test_shifted_cells_get_the_shifted_field():
    position, capacity = ball(80.0)
    first, second = oxygen(), oxygen()
    there = position + np.array([130.0, -70.0, 10.0])  # whole nodes: the same box, shifted
    first.solve(position, capacity)
    second.solve(there, capacity)
    np.testing.assert_allclose(second.sample(there), first.sample(position), rtol=1e-9)


@pytest.mark.parametrize("changes", [{}, {"diffusion_medium": 2600.0}])
def test_cells_may_be_written_into_after_a_solve(changes):
    """In the arrays of the solve before; what is kept of these says nothing then."""
    position, capacity = ball(40.0)
    radius = np.full(len(position), 5.0)
    written, fresh = oxygen(**changes), oxygen(**changes)
    written.solve(position, capacity, radius=radius)
    fresh.solve(position.copy(), capacity, radius=radius.copy())
    position[: len(position) // 2] *= 0.3
    radius *= 0.8
    written.solve(position, capacity, radius=radius)
    fresh.solve(position.copy(), capacity, radius=radius.copy())
    assert written.values.tobytes() == fresh.values.tobytes()


def test_no_cells_leave_the_medium():
    field = oxygen()
    report = field.solve(np.empty((0, 3)), np.empty(0))
    np.testing.assert_allclose(field.field().values, 0.07, rtol=1e-13)
    assert report.uptake == 0.0
    assert field.sample(np.empty((0, 3))).shape == (0,)


@pytest.mark.parametrize("distance", [1e5, 1e9, 1e200])
def test_cells_far_apart_are_refused_in_words_and_the_field_stays(distance):
    field = oxygen()
    field.solve(*ball(40.0))
    before, box = field.field().values, field.layout.box
    far = np.array([[0.0, 0.0, 0.0], [distance, distance, distance]])
    with pytest.raises(MulticellError, match=rf"nodes.*more than the {MAX_NODES} allowed.*larger"):
        field.solve(far, np.ones(2))
    assert field.layout.box == box
    assert field.field().values is before


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_positions_that_are_not_finite_are_refused(bad):
    with pytest.raises(NutrientFailed, match="not a finite number"):
        oxygen().solve(np.array([[0.0, bad, 0.0]]), np.ones(1))


def test_cells_absurdly_far_from_the_origin_are_refused():
    with pytest.raises(NutrientFailed, match="away from the origin"):
        oxygen().solve(np.full((2, 3), 1e14), np.ones(2))


def test_bad_input_is_refused():
    field = oxygen()
    with pytest.raises(ValueError, match="no grid before the first solve"):
        field.field()
    with pytest.raises(ValueError, match="no grid before the first solve"):
        field.sample(np.zeros((1, 3)))
    for capacity in (np.array([-1.0]), np.array([np.nan])):
        with pytest.raises(SceneError, match="negative or not finite"):
            field.solve(np.zeros((1, 3)), capacity)
    with pytest.raises(SceneError, match="capacity: has shape"):
        field.solve(np.zeros((1, 3)), np.ones(2))
    with pytest.raises(ValueError, match="position has shape"):
        field.solve(np.zeros(3), np.ones(1))
    field.solve(np.zeros((1, 3)), np.ones(1))
    with pytest.raises(ValueError, match="outside the nutrient grid"):
        field.sample(np.full((1, 3), np.nan))
    walled = oxygen(sides={"x-": Side(type="derivative", derivative=0.0)})
    walled.solve(np.zeros((1, 3)), np.ones(1))
    with pytest.raises(ValueError, match="outside the nutrient grid"):
        walled.sample(np.full((1, 3), 1e3))


@pytest.mark.slow
@pytest.mark.parametrize("geometry", ["box", "radial"])
@pytest.mark.parametrize("regime", ["steady", "transient"])
def test_a_field_that_goes_on_is_as_one_made_anew_from_its_values(geometry, regime):
    """Stored parts of equation, solver and conditions follow grid, medium and parameters."""
    field = oxygen(geometry=geometry, media=((600.0, 0.02), (1500.0, 0.07)), decay=1e-3)
    field.parameters = replace(field.parameters, regime=regime)
    position, capacity = ball(30.0)
    radius = np.full(len(position), 5.0)
    field.group.fill(Tissue(position, radius), time=0.0)
    # the tissue stays, moves, grows over numbers of nodes, and is again what it was
    course = [(1.0, 0.0), (1.0, 0.0), (1.0, 7.0), (1.3, 7.0), (1.8, 0.0), (1.0, 0.0), (1.0, 0.0)]
    for step, (scale, shift) in enumerate(course):
        begin, place = 300.0 * step, scale * position + shift
        if step == 5:
            nutrient = replace(field.parameters.nutrient, decay=0.0, time_tolerance=1e-4)
            field.parameters = replace(field.parameters, nutrient=nutrient)
        anew = NutrientField("oxygen", field.parameters)
        anew.restore(field.field(), begin)
        for each in (field, anew):
            demand = {"oxygen": ((1.0 + step) * capacity, None)}
            if regime == "steady":
                each.group.solve(Tissue(place, radius), demand, time=begin + 300.0)
            else:
                each.group.advance(Tissue(place, radius), demand, begin=begin, end=begin + 300.0)
        np.testing.assert_array_equal(field.values, anew.values)
        np.testing.assert_array_equal(field.read(field.group.position), anew.sample(place))


# a box of other nodes gets an operator of its own, one of as many that of before, resized
@pytest.mark.parametrize(("way", "further"), [("__init__", 1.6), ("resized", 1.02)])
def test_a_grid_whose_laying_was_cut_short_is_laid_again(way, further, monkeypatch):
    position, capacity = ball(30.0)
    field, plain = oxygen(), oxygen()
    for each in (field, plain):
        each.solve(position, capacity)
    kept = field.solution

    def cut(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(Diffusion, way, cut)
    with pytest.raises(KeyboardInterrupt):
        field.solve(further * position, capacity)
    monkeypatch.undo()
    field.solution = kept
    for each in (field, plain):
        each.solve(further * position, capacity)
    np.testing.assert_array_equal(field.values, plain.values)
