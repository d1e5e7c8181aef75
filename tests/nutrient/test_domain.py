"""A fixed domain: fields that stand still, and cells that its sides hold or that are named."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from running import finished, refused

import multicell as mc
from multicell.contact.law import compliance
from multicell.errors import SceneError, StepFailed
from multicell.nutrient.cartesian import departure
from multicell.scene.domain import filling, strayed
from multicell.scene.parts import Domain
from multicell.scene.scales import scales
from multicell.scene.scene import Scene

BOX = {"x": [-45.0, 65.0], "y": ["-40 um", "30 um"], "z": [-30, 30]}
FLAT = {"x": [-45.0, 65.0], "y": [-40.0, 30.0]}


def scene(**changes):
    entries = {
        "duration": "2 h",
        "initial": {"count": 12, "spacing": 0.9, "stage": "uniform"},
        "contact": {"law": "hertz"},
        "domain": BOX,
    }
    changes = {key.replace("__", "."): value for key, value in changes.items()}
    return Scene.from_dict(entries).with_changes(changes)


# --- how cubes fill a box ----------------------------------------------------------------------


@given(
    st.lists(st.integers(2, 40), min_size=2, max_size=3),
    st.floats(0.3, 20.0),
    st.floats(1.0, 3.0),
)
def test_cubes_fill_a_box_and_no_larger_ones_do(counts, edge, coarser):
    lengths, wanted = [n * edge for n in counts], coarser * edge
    found = filling(lengths, wanted)
    assert found is not None
    steps = np.array(lengths) / found
    np.testing.assert_allclose(steps, steps[0], rtol=1e-9)
    assert steps[0] <= wanted * (1 + 1e-9)
    assert min(found) >= 2
    # by trying all numbers of cubes along the shortest side: coarser ones do not fit
    shortest = min(lengths)
    for n in range(2, round(shortest / steps[0])):
        step = shortest / n
        whole = [abs(length / step - round(length / step)) < 1e-9 for length in lengths]
        assert not (all(whole) and step <= wanted * (1 - 1e-9))


def test_a_box_that_no_cubes_fill():
    assert filling([100.0, 100.0 * np.sqrt(2.0), 50.0], 10.0) is None
    assert filling([100.0, 40.0], 30.0) == (5, 2)


@pytest.mark.parametrize(("flat", "regime"), [(False, "steady"), (True, "transient")])
def test_faces_lie_on_the_sides_and_stay_there_while_tissue_grows(flat, regime):
    changes = {"dimensions": 2, "domain": FLAT} if flat else {}
    described = scene(
        growth={"cycle_time": "8 h"},
        nutrients={
            "oxygen": {"regime": regime, "spacing": "7 um", "boundary": "0.2 mM", "height": "10 um"}
        },
        coupling_step="10 min",
        **changes,
    )
    simulation = mc.Simulation(described)
    layout = simulation.field_system.fields["oxygen"].layout
    first = layout.box
    sides = [first.origin[a] for a in range(2 + (not flat))]
    np.testing.assert_array_equal(sides, [-45.0, -40.0, -30.0][: len(sides)])
    np.testing.assert_allclose(
        first.upper[: len(sides)], [65.0, 30.0, 30.0][: len(sides)], rtol=1e-15
    )
    assert first.spacing == pytest.approx(5.0)
    finished(simulation)
    assert simulation.field_system.fields["oxygen"].layout is layout
    ledger = simulation.ledger["oxygen"]
    assert ledger.relaid == 0.0
    assert ledger.uptake > 0.0
    assert ledger.relative_remainder < 1e-8
    assert simulation.divisions > 0


def test_a_centre_on_any_side_is_on_the_grid():
    """Rounding must not put a corner of the domain outside its own grid."""
    rng = np.random.default_rng(0)
    for _ in range(200):
        edge, counts = rng.uniform(1.0, 9.0), rng.integers(3, 20, 3)
        low = rng.uniform(-100.0, 100.0, 3)
        high = low + edge * counts
        domain = Domain(**{axis: [low[a], high[a]] for a, axis in enumerate("xyz")})
        corners = np.array([low, high])
        position = np.array([[corners[i, 0], corners[j, 1], corners[k, 2]]
                             for i in (0, 1) for j in (0, 1) for k in (0, 1)])  # fmt: skip
        assert strayed(domain, position) is None
        from multicell.nutrient.grid import BoxLayout

        layout = BoxLayout.within(domain, 1.7 * edge, None)
        assert layout.box.spacing <= 1.7 * edge * (1 + 1e-12)
        np.testing.assert_allclose(layout.gather(position, layout.filled(2.0)), 2.0, rtol=1e-12)
        assert strayed(domain, np.nextafter(position[:1], -np.inf)) == (0, "x-")


# --- what is refused ----------------------------------------------------------------------------

OXYGEN = {"oxygen": {}}


@pytest.mark.parametrize(
    ("changes", "path", "words"),
    [
        ({"domain": {"x": [-9, 9], "y": [-9, 9]}}, "domain.z", "is missing"),
        ({"domain": BOX, "dimensions": 2}, "domain.z", "2 dimensions"),
        ({"domain": {**BOX, "x": [5, -5]}}, "domain.x", "lower end first"),
        ({"domain": {**BOX, "x": [5]}}, "domain.x", "two quantities"),
        ({"domain": {**BOX, "x": [-1e7, 0]}}, "domain.x", "at least -1e"),
        ({"domain": {**BOX, "x": [-3, 3]}}, "domain.x", "at least 10 um"),
        ({"nutrients": {"o2": {"geometry": "radial"}}}, "nutrients.o2.geometry", "with a domain"),
        ({"nutrients": {"o2": {"geometry": "auto"}}}, "nutrients.o2.geometry", "with a domain"),
        (
            {"domain": {**BOX, "y": [-30, 41.42135623]}, "nutrients": OXYGEN},
            "domain.y",
            "which no cubes of",
        ),
        (
            {"domain": {k: [-1e4, 1e4] for k in "xyz"}, "nutrients": OXYGEN},
            "nutrients.oxygen.spacing",
            "more than 16777216 nodes",
        ),
    ],
)
def test_bad_domains_are_refused_by_path(changes, path, words):
    with refused(path, words):
        scene(**changes)


def test_a_refused_length_comes_with_one_that_fits():
    changes = {"domain": {**BOX, "y": [-30.0, 41.42135623]}, "nutrients": OXYGEN}
    with pytest.raises(SceneError, match="for example 70 um"):
        scene(**changes)
    changes["domain"] = {**BOX, "y": [-30.0, 40.0]}
    assert scene(**changes).domain.y == (-30.0, 40.0)


def test_cells_that_start_outside_are_refused():
    described = scene(domain={**BOX, "z": [2.0, 62.0]})
    with pytest.raises(SceneError, match=r"domain\.z: is too small: cell \d+ starts at .* side z-"):
        mc.Simulation(described)


def until_failure(simulation):
    """Step until a step fails, and return the failure; the cells are those of its beginning."""
    for _ in range(300):
        before = simulation.cells
        try:
            simulation.step()
        except StepFailed as error:
            assert simulation.cells is before
            return error
    raise AssertionError("no step failed")


def towards(*direction):
    return {"force": 5.0, "bias": 1.0, "direction": direction}


def test_where_nothing_holds_them_a_cell_that_leaves_is_named():
    described = scene(
        domain={**BOX, "young": 1e-9}, motility=towards(0, 1, 0),
        initial__count=3, drag__viscosity="0.05 kPa s", coupling_step="5 s",
        integrator={"method": "euler", "step": 1.0},
    )  # fmt: skip
    simulation = mc.Simulation(described)
    caught = until_failure(simulation)
    ahead = int(simulation.cells.id[simulation.cells.position[:, 1].argmax()])
    assert caught.cell == ahead
    assert "through the side y+" in caught.problem
    assert caught.problem.endswith("um")


def test_a_wall_too_soft_to_hold_is_named():
    described = scene(
        domain={**BOX, "young": "1 Pa"}, motility=towards(1, 0, 0),
        initial__count=1, drag__viscosity="0.05 kPa s", coupling_step="5 s",
        integrator={"method": "cvode"},
    )  # fmt: skip
    simulation = mc.Simulation(described)
    caught = until_failure(simulation)
    assert "side x+" in caught.problem
    assert "domain.young" in caught.hint
    held = finished(described.with_changes({"domain.young": "10 kPa", "duration": "20 min"}))
    radius, young = held.cells.radius[0], held.cells.young[0]
    modulus = 1.0 / (compliance(young, 0.5) + compliance(10.0, 0.5))
    depth = (5.0 / (modulus * np.sqrt(radius))) ** (2 / 3)
    # the force is constant: rest is where Hertz bears it, to the tolerance
    assert held.cells.position[0, 0] == pytest.approx(65.0 - radius + depth, abs=0.02)


def test_a_daughter_outside_fails_the_step_and_leaves_its_beginning():
    """Her centre is within the mother, but may be beyond a side that does not hold."""
    described = scene(
        domain={**BOX, "young": 1e-9}, growth={"cycle_time": "1 h", "cycle_variation": 0.0},
        initial__count=1, initial__stage="birth", duration="3 h",
    )  # fmt: skip
    simulation = mc.Simulation(described)
    simulation.cells.position[0] = [0.0, 0.0, 30.0]
    caught = until_failure(simulation)
    assert "side z+" in caught.problem
    assert simulation.divisions == 0


# --- runs ---------------------------------------------------------------------------------------


def grown(**changes):
    """Return a run in which tissue fills a box and presses against its sides."""
    return scene(
        duration="9 h", growth={"cycle_time": "3 h"}, initial__count=20,
        domain={k: [-17.0, 17.0] for k in "xyz"}, domain__young="5 kPa", cells__young="1 kPa",
        **changes,
    )  # fmt: skip


@pytest.mark.slow
def test_tissue_that_grows_in_a_box_stays_in_it_and_takes_its_shape():
    simulation = finished(grown())
    cells = simulation.cells
    assert len(cells) > 150
    assert np.abs(cells.position).max() < 17.0
    # pressed against all six sides, by some tenths of a radius
    depth = cells.radius[:, None] - (17.0 - np.abs(cells.position))
    assert (depth.max(axis=0) > 0.5).all()
    assert (depth.max(axis=0) < cells.radius.max()).all()
    assert cells.pressure.mean() > 0.05
    free = finished(grown().with_changes({"domain": None}))
    assert np.abs(free.cells.position).max() > 20.0
    assert cells.pressure.mean() > 3.0 * free.cells.pressure.mean()
    # a ball reaches as far along its diagonal as along an axis, a cube √3 times as far
    assert np.linalg.norm(cells.position, axis=1).max() > 1.4 * np.abs(cells.position).max()
    assert departure(cells.position, cells.radius) < 0.05


@pytest.mark.slow
def test_a_cluster_climbs_the_gradient_between_two_reservoirs():
    """The title of the scene, against closed forms.

    Between c = 0 at x = -100 µm and 0.01 mM at x = 400 µm without uptake c is linear, and the force
    F = f g/(g + half) with g = 0.01 mM / 500 µm. Contacts cancel in the sum over all cells, so that
    the centre weighted by the radii moves at N F / (6πη Σ r_i), but for the random motion.
    """
    described = mc.load_scene("chemotaxis")
    frames = mc.run(described).frames
    gradient = 0.01 / 500.0
    centres, found = [], []
    for frame in frames:
        cells, c = frame.cells, frame.concentrations["attractant"]
        np.testing.assert_allclose(c, gradient * (cells.position[:, 0] + 100.0), atol=1e-9)
        field = frame.fields["attractant"]
        nodes = field.origin[0] + (np.arange(field.values.shape[0]) + 0.5) * field.spacing
        exact = gradient * (nodes + 100.0)
        np.testing.assert_allclose(field.values, np.broadcast_to(
            exact[:, None, None], field.values.shape), atol=1e-9)  # fmt: skip
        np.testing.assert_array_equal(field.origin, [-100.0, -60.0, -60.0])
        centres.append(np.average(cells.position, axis=0, weights=cells.radius))
        found.append(c.mean())
        assert cells.position[:, 0].max() + cells.radius.max() < 400.0
    centres = np.array(centres)
    assert (np.diff(centres[:, 0]) > 0.0).all()
    assert (np.diff(found) > 0.0).all()
    assert found[-1] > 3.0 * found[0]
    cells = frames[0].cells
    force = 0.4 * gradient / (gradient + 1e-5)
    speed = len(cells) * force / (6 * np.pi * 0.5 * cells.radius.sum())
    # random pushes of 0.1 nN for 10 min each: v τ √(intervals/3) over √N, below 1 µm in 12 h
    time = np.array([frame.time for frame in frames])
    np.testing.assert_allclose(centres[:, 0] - centres[0, 0], speed * time, atol=2.0)
    assert np.abs(centres[:, 1:]).max() < 2.0
    assert speed * time[-1] > 250.0


# --- what is said -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("ends", "k"),
    [
        (("value", "value"), np.pi / 110.0),
        (("value", "derivative"), np.pi / 220.0),
    ],
)
def test_the_diffusion_time_of_a_domain_is_that_of_its_slowest_mode(ends, k):
    wall = {"type": "derivative", "derivative": 0.0}
    sides = {"*": wall, **{f"x{s}": {"value": 1.0} for s, e in zip("-+", ends, strict=True)
                           if e == "value"}}  # fmt: skip
    described = scene(nutrients={"a": {"sides": sides, "diffusion": 50.0, "uptake": 0.0}})
    assert scales(described, "a").time == pytest.approx(1.0 / (50.0 * k**2))
