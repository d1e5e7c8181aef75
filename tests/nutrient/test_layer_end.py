"""The layer of medium round a tissue ends at one distance, on a grid with corners."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from layered import LEVEL, MARGIN, D, directions, field, packed
from scipy import ndimage, spatial, special
from synthetic import cells_at

import multicell as mc
from multicell.cells import SPHERE
from multicell.nutrient import layer
from multicell.nutrient.balance import BALANCE_COLUMNS
from multicell.nutrient.cartesian import Box, lay
from multicell.nutrient.equations.outside import bring
from multicell.nutrient.fitness import _direction_notes
from multicell.nutrient.layer import _distances, _exposed, exchange_beyond, mean_end
from multicell.report.explain.course import Profile
from multicell.report.explain.scene import explain
from multicell.scene.field_solvers import HELD_RATE, expected_step
from multicell.scene.scales import MAX_UNEVEN
from multicell.vectors import corners

SHAPE = "nutrients.oxygen.margin_shape"


@pytest.mark.parametrize(
    ("order", "radius", "apart"),
    [("first", 120.0, 14.0), ("zeroth", 120.0, 14.0), ("first", 240.0, 8.4)],
    ids=["first", "zeroth", "first-100000-cells"],
)
def test_a_consuming_ball_in_its_layer(order, radius, apart):
    """Both uptakes against closed forms: at the surface, along axes and along diagonals."""
    position, volume = packed(radius, apart)
    end = mean_end(position, np.full(len(position), 8.0), MARGIN)
    assert end == pytest.approx(radius + MARGIN, abs=6.0)
    gap = 1.0 / radius - 1.0 / end
    away = np.sqrt((position**2).sum(axis=1))
    if order == "first":
        rate, half = 0.5, 1e4
        k = np.sqrt(rate / D)
        rise = k * radius * np.cosh(k * radius) - np.sinh(k * radius)
        scale = LEVEL / (np.sinh(k * radius) / radius + rise * gap)
        exact, each = scale * np.sinh(k * away) / away, rate * half * volume
    else:
        rate, half = 0.012, 1e-9
        surface = LEVEL - rate * radius**3 / (3.0 * D) * gap
        exact, each = surface - rate / (6.0 * D) * (radius**2 - away**2), rate * volume
    oxygen = field(10.0, half)
    size = np.full(len(position), 8.0)
    report = oxygen.solve(position, np.full(len(position), each), radius=size)
    found = oxygen.sample(position, size)
    axes, diagonals = directions(position, radius)
    assert axes.sum() > 20
    assert diagonals.sum() > 20
    along, across = (float((found[x] / exact[x]).mean()) for x in (axes, diagonals))
    assert along == pytest.approx(1.0, abs=0.012)
    assert across == pytest.approx(1.0, abs=0.012)
    assert along == pytest.approx(across, abs=0.01)
    assert report.inflow == pytest.approx(report.uptake, rel=1e-8)


def test_a_consuming_disc_in_its_layer():
    """Of first order in a plane: c = A I0(k r), and A' + B log r in the layer."""
    radius, rate = 150.0, 0.5
    position, area = packed(radius, axes=2)
    oxygen = field(8.0, 1e4, dimensions=2)
    size = np.full(len(position), 8.0)
    oxygen.solve(position, np.full(len(position), rate * 1e4 * area * 10.0), radius=size)
    away = np.sqrt((position**2).sum(axis=1))
    angle = np.linspace(0.0, 2.0 * np.pi, 360, endpoint=False)
    along = position[:, :1] * np.cos(angle) + position[:, 1:2] * np.sin(angle)
    left = MARGIN**2 - (away**2)[:, None] + along**2
    ends = np.where(left > 0.0, along + np.sqrt(np.maximum(left, 0.0)), 0.0).max(axis=0)
    k, end = np.sqrt(rate / D), float(ends.mean())
    flow = k * radius * special.i1(k * radius)
    exact = LEVEL * special.i0(k * away)
    exact = exact / (special.i0(k * radius) + flow * np.log(end / radius))
    found = oxygen.sample(position, size)
    outer = (away > radius - 20.0) & (away < radius - 4.0)
    diagonal = np.abs(np.abs(position[:, 0]) - np.abs(position[:, 1])) < 0.3 * away
    axis = np.minimum(np.abs(position[:, 0]), np.abs(position[:, 1])) < 0.25 * away
    ratios = [float((found[x] / exact[x]).mean()) for x in (outer & axis, outer & diagonal)]
    # the lattice ends 5 um nearer along the axes
    assert ratios == pytest.approx([1.0, 1.0], abs=0.02)
    assert ratios[0] == pytest.approx(ratios[1], abs=0.015)


def brute(box, position, reach):
    """Return the nodes beyond all balls that are joined to the ends, and distances from cells."""
    axes = [
        o + (np.arange(-1, n + 1) + 0.5) * box.spacing
        for o, n in zip(box.origin, box.shape, strict=True)
    ]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    away, _ = spatial.cKDTree(position).query(nodes)
    label, _ = ndimage.label(away >= reach)
    inner = (slice(1, -1),) * 3
    return (label == label[0, 0, 0])[inner] & (label[inner] > 0), away[inner]


def test_nodes_beyond_the_layer_and_none_in_a_hollow():
    random = np.random.default_rng(5)
    z, angle = random.uniform(-1, 1, 900), random.uniform(0, 2 * np.pi, 900)
    flat = np.sqrt(1 - z * z)
    shell = 120.0 * np.stack([flat * np.cos(angle), flat * np.sin(angle), z], axis=1)
    box = Box((-180.0, -180.0, -180.0), (36, 36, 36), 10.0)
    radius = np.full(900, 8.0)
    found = exchange_beyond(box, shell, shell, radius, 40.0)
    medium, away = brute(box, shell, 40.0)
    assert found[18, 18, 18] == 0.0  # 120 um from all cells, and shut in
    assert found[0, 0, 0] == HELD_RATE
    assert (found[medium] == HELD_RATE).all()
    assert away[(found == HELD_RATE) & ~medium].min(initial=40.0) > 40.0 - 30.0 / HELD_RATE
    near = ndimage.binary_dilation(medium) & ~medium
    assert (found[near] >= 0.0).all()
    assert (found[~near & ~medium] == 0.0).all()


@pytest.mark.parametrize(
    ("apart", "mean", "most", "part"), [(14.0, 1e-5, 1e-4, 1.0), (7.0, 0.3, 3.0, 0.7)]
)
def test_distances_from_the_nearest_cell(apart, mean, most, part):
    """Exact for few cells; for many by every second node, in µm. Strayed cells reach less far."""
    position, _ = packed(120.0, apart)
    random, spacing, reach = np.random.default_rng(2), 10.0, 50.0
    own = np.full(len(position), reach)
    own[random.integers(0, len(own), 20)] -= random.uniform(0.0, 40.0, 20)
    first, counts = np.full(3, -190.0), [39, 39, 39]
    width = 2.5 * 0.6 * apart
    exposed = _exposed(position, own, width)
    found = _distances(position, own, width, first, spacing, counts) * spacing
    axis = first[0] + spacing * np.arange(39)
    nodes = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)
    whole = own == reach
    true = spatial.cKDTree(position[whole]).query(nodes)[0] - reach
    for place, size in zip(position[~whole], own[~whole], strict=True):
        true = np.minimum(true, np.sqrt(((nodes - place) ** 2).sum(axis=-1)) - size)
    error = (found - true)[np.abs(true) < spacing]
    assert len(error) > 2000
    assert abs(error.mean()) < mean
    assert np.abs(error).max() < most
    assert np.count_nonzero(exposed) <= part * len(position)


@pytest.mark.parametrize("spacing", [10.0, 14.0], ids=["every-second-node", "every-node"])
def test_what_is_left_out_changes_no_bits(monkeypatch, spacing):
    """Octants of balls that other cells cover, in tissue with a hollow and in one lattice."""
    shaken, _ = packed(110.0, 7.0)
    hollow = shaken[(shaken**2).sum(axis=1) > 60.0**2]
    for position in (hollow, 7.0 * np.round(shaken / 7.0)):
        size = np.full(len(position), 4.0)
        low, high = corners(position)
        box = lay(low - 50.0, high + 50.0, spacing)
        found = [exchange_beyond(box, position, position, size, 50.0)]
        assert (found[0] == HELD_RATE).any()
        with monkeypatch.context() as patch:
            patch.setattr(layer, "_exposed", lambda places, *_: np.full(len(places), 255, np.uint8))
            found.append(exchange_beyond(box, position, position, size, 50.0))
        np.testing.assert_array_equal(*found)


def test_the_end_moves_with_the_tissue_without_jumps():
    box, place = Box((-80.0, -80.0, -80.0), (16, 16, 16), 10.0), np.array([[0.3, 0.2, -0.1]])
    totals = []
    for shift in np.linspace(0.0, 10.0, 41):
        moved = place + np.array([shift, 0.0, 0.0])
        rates = exchange_beyond(box, moved, moved, np.array([8.0]), 50.0)
        totals.append(float((rates / (rates + 6.0)).sum()))
    assert np.abs(np.diff(totals)).max() < 0.01 * max(totals)


def test_a_cell_that_strays_carries_no_layer_away():
    box = Box((-100.0, -100.0, -100.0), (20, 20, 20), 10.0)
    near, size = np.zeros((2, 3)), np.full(2, 8.0)
    gone = np.array([[0.0, 0.0, 0.0], [900.0, 0.0, 0.0]])
    alone = exchange_beyond(box, near[:1], near[:1], size[:1], 50.0)
    np.testing.assert_array_equal(exchange_beyond(box, near, gone, size, 50.0), alone)


def test_a_transient_field_ends_there_and_its_account_closes():
    scene = mc.load_scene("spheroid").with_changes(
        {
            "initial.count": 60,
            "duration": "40 min",
            "nutrients.oxygen.regime": "transient",
            SHAPE: "tissue",
        }
    )
    simulation = mc.Simulation(scene)
    while not simulation.finished:
        simulation.step()
    summary = simulation.summary()
    assert abs(summary["ledger"]["oxygen"]["relative_remainder"]) < 1e-9
    assert summary["ledger"]["oxygen"]["inflow"] > 0.0
    values = simulation.fields["oxygen"].values
    assert values[0, 0, 0] == pytest.approx(0.05, rel=1e-3)


def test_py_pde_finds_the_field_of_a_run():
    changes = {"initial.count": 60, "duration": "10 min", SHAPE: "tissue"}
    scene = mc.load_scene("spheroid").with_changes(changes)
    result = mc.run(scene)
    frame = result.frames[-1]
    problem = mc.field_problem(scene, frame)
    found = problem.equation.solve(problem.state, 1.0, solver="multicell-steady", tracker=None)
    np.testing.assert_allclose(found.data, frame.fields["oxygen"].values, rtol=1e-6)
    rest = problem.equation.evolution_rate(found, frame.time).data
    assert np.abs(rest).max() < 1e-6
    later = problem.equation.solve(found, 5.0, solver="multicell-implicit", tracker=None)
    np.testing.assert_allclose(later.data, found.data, rtol=1e-4)


def test_an_explicit_solver_takes_steps_that_the_exchange_bounds():
    """They are about as long as a scene expects, whose spacing may be a little larger."""
    scene = mc.load_scene("spheroid").with_changes(
        {
            "initial.count": 40,
            "duration": "10 min",
            SHAPE: "tissue",
            "nutrients.oxygen.regime": "transient",
            "nutrients.oxygen.solver": "runge-kutta",
        }
    )
    frame = mc.run(scene.with_changes({"nutrients.oxygen.solver": "auto"})).frames[-1]
    problem = mc.field_problem(scene, frame)
    exchange = problem.equation.substances["oxygen"].operator.exchange
    fastest = problem.equation.fastest(problem.state.data[None])
    assert exchange.max() > 0.5 * fastest
    expected = 0.5 * 2.785 / expected_step(scene, "oxygen")
    assert fastest == pytest.approx(expected, rel=0.3)
    data = 0.9 * np.reshape(problem.state.data, (1, *exchange.shape))
    found = bring(
        problem.equation, "runge-kutta", data, 0.0, 0.2, tolerance=1e-4, scales=np.array([0.05])
    )
    entry = dict(zip(BALANCE_COLUMNS, found.amounts[0], strict=True))
    gained = float((found.data - data).sum()) * problem.equation.layout.volumes
    assert gained == pytest.approx(entry["inflow"] - entry["uptake"], rel=1e-9)
    assert entry["inflow"] > 0.0


@pytest.mark.parametrize("axes", [3, 2])
@pytest.mark.parametrize("shape", ["box", "tissue"])
def test_a_note_where_round_tissue_finds_more_along_the_axes(shape, axes):
    """A box has corners, and the same tissue in a layer of its own shape has none."""
    radius = 120.0
    position, volume = packed(radius, axes=axes)
    size = np.full(len(position), 8.0)
    each = np.full(len(position), 0.012 * volume * (10.0 if axes == 2 else 1.0))
    oxygen = field(10.0, 1e-9, of={"margin_shape": shape}, dimensions=axes)
    oxygen.solve(position, each, radius=size)
    notes = _direction_notes(oxygen, cells_at(position, size), LEVEL)
    assert any("margin_shape = 'tissue'" in note for note in notes) == (shape == "box")


@pytest.mark.parametrize("axes", [3, 2])
def test_explain_expects_the_difference_between_directions(axes):
    """Between points of the surface on the axes and on the diagonals, within a tenth of a grid."""
    radius, rate = 120.0, 0.012
    position, volume = packed(radius, axes=axes)
    size = np.full(len(position), 8.0)
    oxygen = field(10.0, 1e-9, of={"margin_shape": "box"}, dimensions=axes)
    each = rate * volume * (10.0 if axes == 2 else 1.0)
    oxygen.solve(position, np.full(len(position), each), radius=size)
    low, high = position.min(axis=0), position.max(axis=0)
    rows = np.vstack([np.eye(3)[:axes], -np.eye(3)[:axes]])
    ends = np.pad(list(product((-1.0, 1.0), repeat=axes)), ((0, 0), (0, 3 - axes)))
    along, between = (
        oxygen.sample(0.5 * (low + high) + radius * way, np.ones(len(way))).mean()
        for way in (rows, ends / np.sqrt(axes))
    )
    true = float(along - between) / LEVEL
    half = MARGIN + 0.5 * float((high - low)[:axes].mean())
    nutrient = replace(oxygen.parameters.nutrient, uptake=each)
    profile = Profile(nutrient, axes, 10.0, reach=lambda _: half)
    cell = volume if axes == 3 else SPHERE * (volume / np.pi) ** 1.5
    profile.solve(np.linspace(0.0, radius, 41), 0.0, 0.0, cell)
    assert true > 2.0 * MAX_UNEVEN
    assert profile.uneven() == pytest.approx(true, rel=0.1)


def test_explain_names_the_key_where_corners_matter():
    notes = {shape: explain(notable(shape))["notes"] for shape in ("box", "tissue")}
    assert any(SHAPE in note for note in notes["box"])
    assert not any(SHAPE in note for note in notes["tissue"])


def notable(shape):
    return mc.load_scene("spheroid").with_changes({SHAPE: shape})


def test_the_shape_of_the_margin_is_refused_where_something_else_states_the_end():
    """Sides, layers, domains and finite media state where the medium begins."""
    scene = mc.load_scene("spheroid").with_changes({SHAPE: "tissue"})
    sides = {"*": {"type": "value", "value": 0.05}}
    for changes in (
        {"domain": {axis: [-200.0, 200.0] for axis in "xyz"}, "nutrients.oxygen.spacing": "10 um"},
        {"nutrients.oxygen.sides": sides},
        {"nutrients.oxygen.finite_medium": {"volume": 1e12}},
        {"nutrients.oxygen.geometry": "radial", "nutrients.oxygen.layer": 40.0},
    ):
        with pytest.raises(mc.SceneError, match="where the medium begins") as refused:
            scene.with_changes(changes)
        assert refused.value.path == SHAPE
    with pytest.raises(mc.SceneError, match="middle of the outermost cells") as refused:
        mc.load_scene("spheroid").with_changes({"nutrients.oxygen.margin": 0})
    assert refused.value.path == "nutrients.oxygen.margin"
    assert scene.with_changes({"nutrients.oxygen.margin": 0}).nutrients["oxygen"].margin == 0.0
