"""Cells are balls to their fields: closed forms, orders in the spacing, accounts, and py-pde."""

import importlib.util
import itertools
from pathlib import Path

import numpy as np
import pytest
from pde import CartesianGrid, ScalarField
from scipy.integrate import quad, solve_bvp
from scipy.stats import qmc

import multicell as mc
from multicell.errors import SceneError
from multicell.nutrient import balls
from multicell.nutrient.balls import OnShells, _boxes_of, _part_within, gather, scatter
from multicell.nutrient.cartesian import Box
from multicell.nutrient.diffusion import Diffusion
from multicell.nutrient.grid import BoxLayout, ShellLayout, tissue_share
from multicell.nutrient.spherical import Shells

_path = Path(__file__).parents[1] / "benchmarks" / "field_orders.py"
_spec = importlib.util.spec_from_file_location("field_orders", _path)
orders = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(orders)


def uniform_ball(dimensions):
    """Return points that fill a ball of radius 1, or a disc in z = 0, evenly, (n, 3)."""
    cube = 2.0 * qmc.Sobol(dimensions, seed=1).random(4096) - 1.0
    found = cube[(cube**2).sum(axis=1) <= 1.0]
    return np.hstack([found, np.zeros((len(found), 3 - dimensions))])


# --- weights --------------------------------------------------------------------------------------


@pytest.mark.parametrize("flat", [False, True])
def test_a_cell_reads_the_mean_of_what_pde_interpolates_over_its_ball(flat):
    shape = (17, 15, 1 if flat else 16)
    grid = CartesianGrid([(0.0, float(n)) for n in shape], shape)
    x, y, z = grid.cell_coords[..., 0], grid.cell_coords[..., 1], grid.cell_coords[..., 2]
    values = 3.0 + np.sin(0.6 * x) * np.cos(0.5 * y + 0.3) + (0.1 * z**1.5 if not flat else 0.0)
    field, middle = ScalarField(grid, values), 0.5 * np.array(shape)
    position = middle + np.random.default_rng(3).uniform(-1.0, 1.0, (5, 3))
    if flat:
        position[:, 2] = 0.5
    box = Box((0.0,) * 3, shape, 1.0, 1.0 if flat else None)
    # one field for all sizes: py-pde compiles for each field anew
    for size in (0.3, 1.0, 1.5, 2.3, 5.0):
        found = gather(box, position, values, np.full(5, size))
        points = size * uniform_ball(2 if flat else 3)
        means = [field.interpolate(place + points).mean() for place in position]
        np.testing.assert_allclose(found, means, atol=3e-3 * size, err_msg=str(size))


@pytest.mark.parametrize("size", [0.0, 0.4, 1.0, 2.5, 4.0])
@pytest.mark.parametrize("flat", [False, True])
def test_lines_are_read_exactly_and_amounts_stay_where_they_are_on_average(size, flat):
    rng, shape, h = np.random.default_rng(4), (19, 18, 1 if flat else 20), 2.5
    origin = (-20.0, -24.0, -1.25 if flat else -25.0)
    box = Box(origin, shape, h, h if flat else None)
    nodes = np.stack(np.meshgrid(*box.axes(), indexing="ij"), axis=-1)
    slope = np.array([0.3, -0.2, 0.0 if flat else 0.5])
    position = 0.5 * (np.array(box.origin) + box.upper) + rng.uniform(-8.0, 8.0, (30, 3))
    position[:, 2] *= not flat
    radius = np.full(30, size * h)
    read = gather(box, position, 7.0 + nodes @ slope, radius)
    np.testing.assert_allclose(read, 7.0 + position @ slope, rtol=1e-12)
    amount = rng.uniform(0.5, 2.0, 30)
    density = scatter(box, position, amount, radius) * h**3
    assert density.min() >= 0.0
    assert density.sum() == pytest.approx(amount.sum(), rel=1e-13)
    np.testing.assert_allclose(
        np.einsum("ijk,ijkl->l", density, nodes), amount @ position, atol=1e-10
    )
    # the transpose: what nodes give is what cells take
    values = rng.random(shape)
    taken = gather(box, position, values, radius)
    assert (density * values).sum() == pytest.approx(amount @ taken, rel=1e-12)


def test_boxes_have_the_second_moments_of_the_ball_and_of_the_disc():
    for flat, count in itertools.product((False, True), (1, 3, 4, 7, 12)):
        filled, size = _boxes_of(count, flat)
        assert filled.min() >= 0.0
        assert filled.sum() == pytest.approx(1.0, rel=1e-12)
        for axis in range(2 if flat else 3):
            along = np.moveaxis(filled, axis, 0).sum(axis=(1, 2))
            at = size * (np.arange(count) - 0.5 * (count - 1))
            moment = along @ (at**2 + size**2 / 12.0)
            assert moment == pytest.approx(0.25 if flat else 0.2, rel=1e-12)


def test_shells_hold_what_of_a_ball_lies_in_them():
    """Spheres round the origin within a ball: their areas by the law of cosines, summed."""
    for away, radius, rho in itertools.product((1e-4, 0.7, 2.0, 6.0), (0.8, 1.7), (0.5, 1.8, 5.7)):

        def area(s, away=away, radius=radius):
            cosine = (s * s + away * away - radius * radius) / (2.0 * s * away)
            return 2.0 * np.pi * s * s * (1.0 - np.clip(cosine, -1.0, 1.0))

        kinks = [x for x in (abs(away - radius), away + radius) if 0.0 < x < rho]
        part = quad(area, 0.0, rho, points=kinks or None, limit=500)[0]
        found = _part_within.py_func(rho, away, radius)
        assert found == pytest.approx(part / (4.0 / 3.0 * np.pi * radius**3), rel=1e-6, abs=1e-9)


def test_shells_keep_amounts_and_read_what_they_spread():
    rng = np.random.default_rng(6)
    away, radius = rng.uniform(0.0, 60.0, 200), rng.uniform(0.0, 12.0, 200)
    away[:2], radius[2:9] = (0.0, 60.0), 0.0
    amount, values = rng.uniform(0.5, 2.0, 200), rng.random(15)
    cells = OnShells.at(15, 4.0, away, radius)
    total = cells.scatter(amount)
    assert total.min() >= 0.0
    assert total.sum() == pytest.approx(amount.sum(), rel=1e-13)
    read = cells.gather(values, values[-1])
    assert total @ values == pytest.approx(amount @ read, rel=1e-12)
    # a cell as wide as all shells takes no more than one weight for each
    wide = OnShells.at(15, 4.0, away, np.append(radius[:-1], 500.0))
    assert wide.weights.shape == (200, 16)
    assert wide.scatter(amount).sum() == pytest.approx(amount.sum(), rel=1e-13)
    # evenly filled space has an even density, in the innermost shell too
    layout = ShellLayout(np.zeros(3), 2.0, 20)
    grid = np.arange(-39.0, 40.0, 2.0)
    places = np.stack(np.meshgrid(grid, grid, grid), axis=-1).reshape(-1, 3)
    places = places[np.linalg.norm(places, axis=1) < 38.0]
    density = layout.scatter(places, np.full(len(places), 8.0), np.full(len(places), 5.0))
    np.testing.assert_allclose(density[:14], 1.0, atol=0.02)


@pytest.mark.parametrize("kind", ["box", "plane", "shells"])
def test_cells_that_are_kept_have_the_bits_of_others(kind):
    def new():
        if kind == "shells":
            return ShellLayout(np.zeros(3), 2.0, 20)
        height = 2.0 if kind == "plane" else None
        low, count = (-20.0, -20.0, -1.0 if height else -20.0), (20, 20, 1 if height else 20)
        return BoxLayout(Box(low, count, 2.0, height))

    rng = np.random.default_rng(8)
    position, radius, amount = rng.uniform(-9.0, 9.0, (50, 3)), rng.random(50), rng.random(50)
    values = rng.random(new().shape)
    value = {"value": 0.1}
    sides = value if kind == "shells" else {a + b: value for a in "xyz" for b in "-+"}
    layout = new()
    layout.keep(position, radius)
    layout.keep(position, radius)
    # neither another place nor another radius is theirs
    for place, size in ((position, radius), (position + 1.0, radius), (position, 2.0 * radius),
                        (position, None), (position.copy(), radius.copy())):  # fmt: skip
        for found, alone in (
            (layout.scatter(place, amount, size), new().scatter(place, amount, size)),
            (layout.gather(place, values, size), new().gather(place, values, size)),
            (layout.read(place, values, sides, size), new().read(place, values, sides, size)),
            (layout.nearest(3.0 * place), new().nearest(3.0 * place)),
        ):
            np.testing.assert_array_equal(found, alone)


@pytest.mark.parametrize("bad", [-1.0, np.nan, np.inf])
def test_radii_that_are_none_are_refused(bad):
    with pytest.raises(ValueError, match="radius"):
        gather(
            Box((-2.0,) * 3, (4,) * 3, 1.0), np.zeros((1, 3)), np.ones((4,) * 3), np.array([bad])
        )
    grid, lactate = CartesianGrid([(-2, 2)] * 3, 4), mc.Substance(10.0, 0.0, production=np.ones(1))
    with pytest.raises(SceneError, match="radius"):
        mc.FieldEquation(grid, {"lactate": lactate}, np.zeros((1, 3)), radius=np.array([bad]))
    with pytest.raises(SceneError, match=r"radius.*shape"):
        mc.FieldEquation(grid, {"lactate": lactate}, np.zeros((1, 3)), radius=np.ones(2))


def test_cells_at_a_face_read_its_condition_and_never_less_than_nothing():
    rng = np.random.default_rng(5)
    box = Box((0.0, 0.0, 0.0), (9, 8, 7), 1.0)
    layout, values = BoxLayout(box), rng.random(box.shape)
    sides = {axis + end: {"value": 0.0} for axis in "xyz" for end in "-+"}
    position = rng.random((400, 3)) * box.upper
    position[::2, 0] = 0.0
    for size in (0.4, 1.3, 2.4):
        found = layout.read(position, values, sides, np.full(400, size))
        assert (found >= 0.0).all()
        np.testing.assert_allclose(found[::2], 0.0, atol=1e-14)
    # a line between two values is read exactly by balls that reach beyond the faces
    line = np.broadcast_to(0.2 * (np.arange(9) + 0.5)[:, None, None], box.shape)
    walls = {axis + end: {"derivative": 0.0} for axis in "yz" for end in "-+"}
    walls |= {"x-": {"value": 0.0}, "x+": {"derivative": 0.2}}
    read = layout.read(position, np.ascontiguousarray(line), walls, np.full(400, 2.4))
    np.testing.assert_allclose(read, 0.2 * position[:, 0], atol=1e-13)


def test_weights_hold_for_boxes_and_balls_of_any_size(monkeypatch):
    """None below zero, all amounts kept, the transpose, alone as among others, for any threads."""
    monkeypatch.setattr(balls, "_PART", 2)
    rng = np.random.default_rng(9)
    for _ in range(80):
        shape, h = tuple(int(n) for n in rng.integers(1, 12, 3)), float(np.exp(rng.uniform(-3, 3)))
        height = None if rng.random() < 0.7 else 2.0
        shape = shape if height is None else (*shape[:2], 1)
        low = (*rng.normal(0.0, 10.0, 2), rng.normal() if height is None else -0.5 * h)
        box, n = Box(low, shape, h, height), int(rng.integers(1, 100))
        size = np.array(box.upper) - box.origin
        position = np.array(box.origin) + size * np.clip(
            rng.uniform(-0.1, 1.1, (n, 3)), 0, 1 - 1e-9
        )
        position[:, 2] *= height is None
        radius = h * np.where(rng.random(n) < 0.3, 0.0, np.exp(rng.uniform(-6.0, 2.5, n)))
        amount, values = rng.random(n), rng.random(shape)
        density, read = (
            scatter(box, position, amount, radius),
            gather(box, position, values, radius),
        )
        for threads in (2, 5):
            shared = scatter(box, position, amount, radius, threads)
            assert shared.tobytes() == density.tobytes()
            shared = gather(box, position, values, radius, threads)
            assert shared.tobytes() == read.tobytes()
        assert density.min() >= 0.0
        assert box.volume * density.sum() == pytest.approx(amount.sum(), rel=1e-11)
        assert box.volume * (density * values).sum() == pytest.approx(amount @ read, rel=1e-11)
        assert gather(box, position[:1], values, radius[:1])[0] == pytest.approx(read[0], rel=1e-12)
        for bad in (np.nan, np.inf, -np.inf, 1e300):
            lost = position.copy()
            lost[n // 2, rng.integers(2)] = bad
            for threads in (1, 3):
                with pytest.raises(ValueError, match="outside"):
                    scatter(box, lost, amount, radius, threads)


# --- the concentration at a cell ------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["cubes", "squares", "shells"])
def test_what_a_cell_finds_of_its_own_converges_to_the_closed_form_at_second_order(kind):
    """One cell that secretes: down to a fifth of its radius; a point's diverges."""
    spacings, errors = orders.own(kind)
    assert spacings.max() >= 0.99
    assert spacings.min() == pytest.approx(0.2, rel=0.05)
    # on shells round the cell errors of two kinds nearly cancel
    assert 1.85 < orders.order(spacings, errors) < (2.15 if kind != "shells" else 5.0)
    assert errors[-1] < 0.015


def test_what_a_cell_finds_does_not_depend_on_where_it_lies_between_nodes():
    """At spacings of 1 and 1.3 radii; trilinear points differ by more than a factor of two."""
    rng, found = np.random.default_rng(2), {}
    for n, radius in ((12, 1.0), (12, 0.75), (12, 0.0)):
        box = Box((-6.0,) * 3, (n,) * 3, 1.0)
        operator, found[radius] = Diffusion(box, 1.0, 0.0), []
        for offset in (*rng.uniform(-0.5, 0.5, (12, 3)), np.zeros(3), np.full(3, 0.5)):
            place, cell = offset[None], np.array([radius])
            density = scatter(box, place, np.ones(1), cell)
            c, _ = operator.invert(density, 0.0)
            found[radius].append(gather(box, place, c, cell)[0])
    spread = {radius: max(x) / min(x) for radius, x in found.items()}
    assert spread[1.0] < 1.05
    assert spread[0.75] < 1.12
    assert spread[0.0] > 2.0


def test_saturating_uptake_in_a_ball_is_that_of_a_boundary_value_problem():
    """Michaelis-Menten all over the ball, by shells and by SciPy's collocation."""
    most, half, diffusion, radius, outer, level = 4.0e4, 0.05, 800.0, 6.0, 30.0, 0.1
    density = most / (4.0 / 3.0 * np.pi * radius**3)

    def slopes(rho, y):
        inside = 0.5 * (1.0 - np.tanh((rho - radius) / 1e-3))
        taken = density * inside * y[0] / (half + y[0])
        return np.vstack([y[1], taken / diffusion - 2.0 * y[1] / np.maximum(rho, 1e-9)])

    ends = np.concatenate(
        [
            np.linspace(1e-6, radius - 0.01, 300),
            np.linspace(radius - 0.009, radius + 0.009, 200),
            np.linspace(radius + 0.01, outer, 300),
        ]
    )
    exact = solve_bvp(
        slopes,
        lambda a, b: np.array([a[1], b[0] - level]),
        ends,
        np.vstack([np.full(ends.size, 0.05), np.zeros(ends.size)]),
        tol=1e-8,
        max_nodes=100_000,
    )
    assert exact.success
    rho = np.linspace(1e-6, radius, 4001)
    weights = 3.0 * rho**2 / radius**3
    mean = np.trapezoid(weights * exact.sol(rho)[0], rho)
    taken = most * np.trapezoid(weights * exact.sol(rho)[0] / (half + exact.sol(rho)[0]), rho)
    errors, spacings = [], np.array([6.0, 4.0, 3.0, 2.0, 1.5, 1.0])
    for h in spacings:
        layout = ShellLayout.to(np.zeros(3), outer, h)
        cell = np.zeros((1, 3)), np.array([radius])
        sink = layout.scatter(cell[0], np.array([most]), cell[1])
        shells = Shells(layout.radius, layout.count, diffusion, level)
        c, report = shells.solve(sink, half, layout.filled(level))
        assert c.min() >= 0.0
        own = most * layout.gather(cell[0], c / (half + c), cell[1])[0]
        assert own == pytest.approx(report.uptake, rel=1e-12)
        assert report.inflow == pytest.approx(report.uptake, rel=1e-8)
        errors.append([layout.gather(cell[0], c, cell[1])[0] - mean, own - taken])
    errors = np.abs(errors) / [mean, taken]
    assert (np.array([orders.order(spacings, x) for x in errors.T]) > 1.8).all()
    assert errors[-1].max() < 0.02


# --- tissue ---------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("geometry", ["box", "radial"])
def test_oxygen_at_the_cells_of_a_tissue_converges_and_the_reported_error_holds(geometry):
    found = orders.oxygen(
        count=200, spacings=(11.0, 7.8, 5.5, 3.9, 2.8), fine=1.1, geometry=geometry
    )
    assert 1.7 < orders.order(found.spacing, found.rms) < 2.5
    assert found.lowest > 0.0
    assert found.remainder < 1e-8
    below = found.spacing < 5.5
    assert below.sum() >= 2
    assert (found.reported[below] >= found.largest[below]).all()
    # an estimate of this error, not of another one
    assert (found.reported < 4.0 * found.largest).all()


@pytest.mark.slow
def test_a_tissue_in_a_medium_that_diffuses_faster_converges_to_one_value():
    """Gaps between cells are tissue however fine the grid: cubes end where shells do."""
    found = orders.medium(count=400, spacings=(9.5, 6.4, 4.2, 2.8))
    drop = 0.1 - found.fine_on_shells
    assert np.abs(found.centre - found.fine_on_shells)[1:].max() < 0.06 * drop
    assert np.ptp(found.centre[-2:]) < 0.01 * drop
    assert (found.reported >= np.abs(found.centre - found.centre[-1]))[:-1].all()


def test_gaps_between_cells_of_a_tissue_are_tissue():
    rng = np.random.default_rng(1)
    a = 5.0 * 2.0**0.5  # of a face-centred lattice of balls that touch
    whole = np.array([p for p in itertools.product(range(-8, 9), repeat=3) if sum(p) % 2 == 0])
    position = a * whole + rng.normal(scale=0.3, size=whole.shape)
    radius = np.full(len(position), 5.0)
    position = position[(np.abs(position) < 60.0).all(axis=1)]
    inner = (np.abs(position) < 20.0).all(axis=1)
    layout = BoxLayout(Box((-60.0,) * 3, (60,) * 3, 2.0))
    share = tissue_share(layout, position, radius[: len(position)])
    assert inner.sum() > 20
    assert share[20:40, 20:40, 20:40].min() > 0.999


@pytest.mark.parametrize("dimensions", [2, 3])
def test_cells_of_a_run_do_not_see_the_spacing(dimensions):
    """A secreting cell in a box: half a radius, a quarter and an eighth; before, it diverged."""
    found = []
    domain = {axis: ["-15 um", "15 um"] for axis in "xyz"[:dimensions]}
    for spacing in (2.5, 1.25, 0.625)[: dimensions + 1 if dimensions == 2 else 2]:
        scene = mc.load_scene("sorting-signal").with_changes(
            {
                "initial.count": 1,
                "duration": "1 min",
                "coupling_step": "1 min",
                "nutrients.factor.spacing": f"{spacing} um",
                "dimensions": dimensions,
                "domain": domain,
                "types.maker.fraction": 1.0,
                "types.plain.fraction": 0.0,
            }
        )
        simulation = mc.Simulation(scene, threads=1)
        simulation.step()
        found.append(float(simulation.concentrations["factor"][0]))
        # py-pde's side is made of the same terms
        frame = simulation.frame()
        problem = mc.field_problem(scene, frame)
        own = simulation.field_system.fields["factor"]
        secreted = problem.equation.substances["factor"].secreted
        np.testing.assert_array_equal(secreted, own.group.equation.substances["factor"].secreted)
    np.testing.assert_allclose(found, found[-1], rtol=0.15)


@pytest.mark.parametrize("spacing", [12.0, 6.0, 4.0, 3.0, 1.5])
def test_the_reported_error_of_a_lone_cell_is_not_below_the_true_one(spacing):
    """Its own contribution, between cubes that do not resolve it; by the closed form."""
    cell = np.zeros((1, 3)), np.array([6.0])
    _, found, reported, _ = orders.solved(spacing, cell, margin=24.0, half_saturation=1e-9)
    taken = 20.0 * (1.2 / 6.0 - 1.0 / (orders.HARMONIC * 48.0)) / (4.0 * np.pi * 2000.0)
    true = abs(found[0] - (0.1 - taken))
    assert true <= reported < 2.5 * true


def test_a_cell_finds_no_gradient_of_what_it_secretes_itself():
    """In the middle of a ball it is zero; that of a point grows as the squared spacing falls."""
    steps, offsets = np.array([1.0, 0.5, 0.25]), np.random.default_rng(0).uniform(-0.5, 0.5, (6, 3))
    found = []
    for h in steps:
        n = round(8.0 / h)
        layout = BoxLayout(Box((-4.0,) * 3, (n,) * 3, h))
        operator, largest = Diffusion(layout.box, 1.0, 0.0), 0.0
        for place in h * offsets[:, None]:
            c, _ = operator.invert(layout.scatter(place, np.ones(1), np.ones(1)), 0.0)
            largest = max(largest, float(np.abs(layout.gradient(place, c)).max()))
        found.append(4.0 * np.pi * largest)  # over that at the surface
    assert orders.order(steps, np.array(found)) > 1.8
    assert found[0] < 0.06
