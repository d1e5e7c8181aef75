"""Fields that live on what a tolerance asks for: no finer than needed, and right within it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad, solve_bvp
from scipy.special import ive

import multicell as mc
from multicell.errors import SceneError
from multicell.nutrient.choosing import choice as choices
from multicell.nutrient.choosing import own_dip
from multicell.nutrient.choosing.estimate import Load, on_grid, spacing_error, trial
from multicell.nutrient.field import NutrientField
from multicell.nutrient.fields import Feeding
from multicell.nutrient.grid import BoxLayout
from multicell.nutrient.parameters import FieldParameters
from multicell.report.explain.scene import explain
from multicell.scene.nutrient import Nutrient
from multicell.scene.scene import Scene

AIR = {"boundary": "0.07 mM", "uptake": "20 amol/s"}
SUGAR = {
    "diffusion": "105 um^2/s", "boundary": "5 mM", "uptake": "95 amol/s",
    "half_saturation": "0.04 mM",
}  # fmt: skip


def scene(fields, **changes):
    tables = {f"nutrients.{name}": table for name, table in fields.items()}
    growing = {
        "initial.count": 60, "initial.stage": "asynchronous", "duration": "12 h",
        "coupling_step": "20 min", "growth.cycle_time": "10 h", "output.every": "4 h",
    }  # fmt: skip
    return mc.load_scene("growth").with_changes({**growing, **tables, **changes})


def chosen(described, name="oxygen"):
    feeding = mc.Simulation(described).field_system
    return feeding.grids.choices[name], feeding.grids.choosers[name]


# --- what a cell finds of its own uptake -------------------------------------------------------


def test_lattice_green_functions_are_watson_s_integrals():
    for order, value in zip(
        [(0, 0, 0), (1, 0, 0), (1, 1, 0), (1, 1, 1)], own_dip._CUBES, strict=True
    ):

        def bessel(t, order=order):
            return 0.5 * ive(order[0], t) * ive(order[1], t) * ive(order[2], t)

        near = quad(bessel, 0.0, 50.0, limit=300)[0]
        far = quad(lambda s: bessel(s**-2) * 2.0 / s**3, 1e-9, 50.0**-0.5, limit=300)[0]
        assert near + far == pytest.approx(value, abs=1e-9)
    a, b, c = own_dip._SQUARES
    k = np.pi * (np.arange(2000) + 0.5) / 2000
    x, y = np.meshgrid(k, k)
    for kernel, at in ((b, np.cos(x)), (c, np.cos(x) * np.cos(y))):
        assert np.mean((at - 1.0) / (4 - 2 * np.cos(x) - 2 * np.cos(y))) == pytest.approx(
            kernel - a, abs=1e-6
        )


@pytest.mark.parametrize("dimensions", [2, 3])
def test_without_its_own_dip_a_lone_cell_finds_the_medium_on_every_grid(dimensions):
    """What a cell in the middle finds then differs by what comes back from the sides only."""
    found = {}
    for uptake in (0.0, 40.0):
        nutrient = Nutrient(boundary=0.05, uptake=uptake, margin=200.0, half_saturation=1e-9)
        parameters = FieldParameters(nutrient, 10.0, 10.0, "steady", dimensions)
        place = np.array([[0.7, 0.4, 0.2 * (dimensions == 3)]])
        load = Load(place, np.full(1, 5.0), {"a": (np.full(1, uptake), None)}, 0.0, 600.0)
        field = NutrientField("a", parameters)
        for h in (20.0, 10.0, 5.0):
            boxes = {"a": on_grid(parameters, "box", h)}
            found[uptake, h] = float(trial(field.group, boxes, load).around[0, 0])
    back = [found[40.0, h] - found[0.0, h] for h in (20.0, 10.0, 5.0)]
    # Kirchhoff: q/(4 pi D h) alone would be 8e-5 and more, growing as h falls
    assert np.ptp(back) < 2e-6
    if dimensions == 3:
        # the sides, one image of the cell in each: a harmonic function
        assert 0.0 < back[-1] < 40.0 / (4.0 * np.pi * 2000.0 * 150.0)


# --- the estimate against what is not ours -----------------------------------------------------


def balls(described, cells, spacing, points=150):
    """Return what each cell, a ball that takes up, finds of all others: on a fine grid.

    A cell's uptake is spread evenly over its ball, and read as the mean over it; of its own it
    finds 6/5 u/(4 pi D a), the mean potential of a uniform ball.
    """
    feeding = Feeding(described)
    (name,) = feeding.fields
    feeding.begin(cells, 0.0)
    capacity, _ = feeding.demand_now(name, cells)
    p = feeding.fields[name].parameters
    rng = np.random.default_rng(7)
    unit = rng.normal(size=(points, 3))
    unit /= np.linalg.norm(unit, axis=1)[:, None]
    unit *= ((np.arange(points) + 0.5) / points)[:, None] ** (1.0 / 3.0)
    spread = cells.position[:, None] + cells.radius[:, None, None] * unit
    place = spread.reshape(-1, 3)
    field = NutrientField(name, on_grid(p, "box", spacing))
    layout = BoxLayout.round(cells.position, p.nutrient.margin, spacing, None)
    field.lay = lambda position, radius, strays: (layout, False, position)
    each = np.repeat(capacity / points, points)
    field.solve(place, each, radius=np.ones(len(place)))
    mean = field.sample(place).reshape(-1, points).mean(axis=1)
    taken = field.uptake(place, each).reshape(-1, points).sum(axis=1)
    return mean + 1.2 * taken / (4.0 * np.pi * p.nutrient.diffusion * cells.radius)


@pytest.mark.parametrize(
    ("nutrient", "tolerance"),
    [(AIR, 2e-3), (AIR, 5e-4), (AIR, 1.5e-4), (SUGAR, 0.05), (SUGAR, 0.015)],
)
def test_cells_find_what_they_would_as_balls_on_a_much_finer_grid(nutrient, tolerance):
    name = "oxygen" if nutrient is AIR else "glucose"
    table = {**nutrient, "tolerance": tolerance, "regime": "steady"}
    described = scene({name: table}, **{"initial.count": 80})
    simulation = mc.Simulation(described)
    cells, field = simulation.cells, simulation.field_system.fields[name]
    choice = simulation.field_system.grids.choices[name]
    capacity, _ = simulation.field_system.demand_now(name, cells)
    load = Load(cells.position, cells.radius, {name: (capacity, None)}, 0.0, 600.0)
    found = trial(field.group, {name: field.parameters}, load).around[0]
    error = np.abs(found - balls(described, cells, 2.5)).max()
    assert error <= tolerance
    assert choice.error <= tolerance
    # no finer than needed: the coarsest allowed, or not far below the tolerance
    if choice.spacing < 19.9:
        assert choice.error > 0.1 * tolerance


@pytest.mark.parametrize("tolerance", [1e-3, 2e-4, 4e-5])
def test_shells_against_an_outside_solver(tolerance):
    """A ball of evenly spread uptake, D (c'' + 2 c'/r) = n q/V c/(K + c), by solve_bvp."""
    n, ball, q, d, k, level = 6000, 120.0, 20.0, 2000.0, 0.005, 0.07
    share = (np.arange(n // 2) + 0.5) / (n // 2)
    unit = np.random.default_rng(5).normal(size=(n // 2, 3))
    unit *= (ball * share ** (1.0 / 3.0) / np.linalg.norm(unit, axis=1))[:, None]
    place = np.concatenate([unit, -unit])  # the centre of mass is the origin
    described = scene({"oxygen": {**AIR, "geometry": "radial", "tolerance": tolerance}})
    chooser = choices.Chooser(described, "oxygen")
    parameters = FieldParameters.of(described, "oxygen")
    capacity = np.full(n, q / 3.0)
    load = Load(place, np.full(n, 5.0), {"oxygen": (capacity, None)}, 0.0, 1200.0)
    field = NutrientField("oxygen", parameters)
    choice = chooser.choose(field.group, load, None, [level], [0.0])["oxygen"]
    field.parameters = choice.applied(parameters)
    field.solve(place, capacity, radius=load.radius)
    outer = field.layout.radius
    density = n * q / 3.0 / (4.0 / 3.0 * np.pi * ball**3)

    def inside(r, y):
        c = np.maximum(y[0], 0.0)
        return np.array([y[1], density / d * c / (k + c) - 2.0 * y[1] / r])

    def ends(a, b):  # beyond the tissue c = level - A (1/r - 1/outer)
        return np.array([a[1], b[0] + b[1] * ball**2 * (1.0 / ball - 1.0 / outer) - level])

    r = np.linspace(1e-3, ball, 400)
    exact = solve_bvp(
        inside, ends, r, np.vstack([0.0 * r + 0.03, 0.0 * r]), tol=1e-9, max_nodes=10**5
    )
    assert exact.success
    distance = np.linalg.norm(place - field.layout.centre, axis=1)
    error = np.abs(field.sample(place) - exact.sol(distance)[0]).max()
    assert error <= tolerance
    if choice.spacing < 19.9:
        assert choice.error > 0.1 * tolerance


def test_a_transient_field_is_right_within_its_tolerance():
    """Against the same run on a grid of a quarter of the spacing; cells that do not move."""
    still = {
        "growth": None, "duration": "90 s", "coupling_step": "5 s", "initial.count": 30,
        "initial.jitter": 0.0,
    }  # fmt: skip
    fields = {"diffusion": "20 um^2/s", "boundary": "1 mM", "uptake": "5 amol/s"}
    tolerance = 5e-3
    coarse = mc.Simulation(scene({"sugar": {**fields, "tolerance": tolerance}}, **still))
    choice = coarse.field_system.grids.choices["sugar"]
    assert not choice.steady
    fine = mc.Simulation(
        scene({"sugar": {**fields, "spacing": 2.5, "regime": "transient"}}, **still)
    )
    for simulation in (coarse, fine):
        while not simulation.finished:
            simulation.step()
    around = []
    for simulation in (coarse, fine):
        field, cells = simulation.field_system.fields["sugar"], simulation.cells
        capacity, _ = simulation.field_system.demand_now("sugar", cells)
        taken = field.uptake(cells.position, capacity)
        dip = own_dip.own_dip(field.layout, cells.position, taken, 20.0)
        around.append(field.sample(cells.position) + dip)
    assert coarse.cells.position == pytest.approx(fine.cells.position)
    assert np.abs(around[0] - around[1]).max() <= tolerance
    assert coarse.ledger["sugar"].relative_remainder <= 1e-8


# --- what is chosen, and what it costs ---------------------------------------------------------


def test_cost_grows_as_the_tolerance_falls():
    nodes, spacings = [], []
    for tolerance in (1e-2, 2e-3, 5e-4, 1.5e-4):
        table = {**AIR, "geometry": "box", "tolerance": tolerance}
        choice, _ = chosen(scene({"oxygen": table}, **{"initial.count": 200}))
        nodes.append(choice.nodes)
        spacings.append(choice.spacing)
        assert choice.error <= tolerance
    assert nodes == sorted(nodes)
    assert nodes[-1] > 10 * nodes[0]
    assert spacings[0] == 20.0
    assert spacings == sorted(spacings, reverse=True)


def test_shells_serve_until_their_geometry_is_the_error():
    described = scene({"oxygen": {**AIR, "tolerance": 2e-3}}, **{"initial.count": 400})
    loose, chooser = chosen(described)
    assert loose.radial
    assert {fit.geometry for fit in chooser.fits} == {"radial", "box"}
    assert loose.nodes < 10
    tight, _ = chosen(described.with_changes({"nutrients.oxygen.tolerance": 2e-4}))
    assert not tight.radial
    kept, _ = chosen(described.with_changes({"nutrients.oxygen.geometry": "box"}))
    assert not kept.radial


@pytest.mark.parametrize(
    "changes",
    [
        {"dimensions": 2, "nutrients.oxygen.height": "10 um"},
        {"domain": {axis: [-60, 60] for axis in "xyz"}},
        {"nutrients.oxygen.sides": {"x-": {"type": "derivative", "derivative": 0}}},
        {"nutrients.oxygen.sources": {"a": {"x": 0, "y": 0, "z": 0, "strength": 10}}},
    ],
)
def test_where_shells_cannot_be_there_are_cubes_or_squares(changes):
    choice, _ = chosen(scene({"oxygen": {**AIR, "tolerance": 2e-3}}, **changes))
    assert not choice.radial


def test_what_settles_within_a_coupling_step_is_steady():
    slow = {**SUGAR, "diffusion": "5 um^2/s", "uptake": "1 amol/s", "tolerance": "0.02 mM"}
    described = scene({"glucose": slow})
    assert not chosen(described.with_changes({"coupling_step": "1 min"}), "glucose")[0].steady
    assert chosen(described.with_changes({"coupling_step": "1 h"}), "glucose")[0].steady
    given = described.with_changes(
        {"nutrients.glucose.regime": "transient", "coupling_step": "1 h"}
    )
    assert not chosen(given, "glucose")[0].steady
    walls = {"*": {"type": "derivative", "derivative": 0.0}}
    closed = described.with_changes({"nutrients.glucose.sides": walls, "coupling_step": "1 h"})
    assert not chosen(closed, "glucose")[0].steady


def test_a_scene_without_tolerance_loads_nothing_of_it():
    feeding = mc.Simulation(scene({"oxygen": AIR})).field_system
    assert feeding.grids.choosers == {}
    assert feeding.grids.columns() == {}
    assert feeding.grids.kept() == {}


# --- as the tissue grows -----------------------------------------------------------------------

GROWN = {
    "cubes": {"oxygen": {**AIR, "tolerance": 2e-4, "geometry": "box"}},
    "shells to cubes": {"oxygen": {**AIR, "tolerance": 1.5e-3}},
    "transient": {
        "glucose": {**SUGAR, "tolerance": "0.05 mM", "regime": "transient",
                    "media": [["6 h", "2 mM"]]}
    },
    "two": {"oxygen": {**AIR, "tolerance": 2e-4}, "glucose": {**SUGAR, "tolerance": "0.1 mM"}},
    "finite": {
        "glucose": {**SUGAR, "tolerance": "0.1 mM", "finite_medium": {"volume": 5e7},
                    "media": [["6 h", "5 mM"]]}
    },
}  # fmt: skip


@pytest.mark.parametrize("kind", GROWN)
def test_a_growing_run_keeps_its_tolerance_and_its_account_and_can_be_resumed(kind):
    described = scene(GROWN[kind], **{"coupling_step": "30 min"})
    result = mc.run(described)
    last, summary = result.frames[-1], result.summary()
    assert summary["ledger"]["relative_remainder"] <= 1e-8
    for name, nutrient in described.nutrients.items():
        errors = result.history[f"grid_error_{name}"]
        assert (errors <= nutrient.tolerance).all()
        assert len(set(errors)) > 5, "the choice was never looked at again"
        assert summary["fields"][name]["estimated_error"] == errors[-1]
        assert summary["units"][f"fields.{name}.estimated_error"] == "mM"
        widest = result.history[f"spacing_{name}"][-1]
        assert last.fields[name].spacing <= widest * (1.0 + 1e-12)
    again = mc.Simulation(result.scene, frame=result.frames[-2])
    while not again.finished:
        again.step()
    assert again.frame().progress.grids == last.progress.grids
    for name in described.nutrients:
        assert np.array_equal(again.concentrations[name], last.concentrations[name])
        assert np.array_equal(again.fields[name].values, last.fields[name].values)
        assert again.ledger[name].kept() == last.progress.ledger[name]


def test_a_spacing_that_gives_way_does_so_rarely():
    result = mc.run(scene({"oxygen": {**AIR, "tolerance": 2e-4, "geometry": "box"}}))
    spacing = result.history["spacing_oxygen"]
    assert 1 <= np.count_nonzero(np.diff(spacing)) <= 3
    assert spacing[-1] < spacing[0]


@pytest.mark.parametrize("table", [{"tolerance": 1.5e-3}, {"geometry": "auto"}])
def test_a_run_that_goes_over_from_shells_to_cubes_says_so(table, tmp_path):
    """A chain of cells is no ball, and becomes none: it is stretched out between two frames."""
    described = scene({"oxygen": {**AIR, **table}}, **{"initial.count": 400, "growth": None})
    described = described.with_changes({"duration": "2 h"})
    simulation = mc.Simulation(described)
    simulation.step()
    assert simulation.fields["oxygen"].kind == "radial"
    assert not any("went over" in note for note in simulation.summary().get("notes", []))
    cells = simulation.cells.copy()
    cells.position = cells.position * np.array([4.0, 0.7, 0.7])
    simulation.cells = cells
    feeding, time = simulation.field_system, simulation.time
    if feeding.grids.choices:
        now = feeding.grids.choices["oxygen"]
        feeding.grids.choices["oxygen"] = replace(now, content=0.0)  # let it look
    feeding.advance(cells, time, time + 60.0)
    assert simulation.fields["oxygen"].kind == "box"
    (note,) = [x for x in simulation.summary()["notes"] if "went over" in x]
    assert f"oxygen went over from shells to cubes at {(time + 60.0) / 3600.0:.4g} h" in note
    again = mc.Simulation(described, frame=simulation.frame())
    assert note in again.summary()["notes"]


def test_a_step_that_fails_leaves_the_choice_as_it_was(monkeypatch):
    simulation = mc.Simulation(scene({"oxygen": {**AIR, "tolerance": 2e-4}}))
    grids = simulation.field_system.grids
    before, parameters = grids.kept(), simulation.field_system.fields["oxygen"].parameters
    monkeypatch.setattr(choices.Chooser, "due", lambda *_: True)
    real = simulation._decide

    def fail(dt):
        assert grids.kept() != before
        raise KeyboardInterrupt

    monkeypatch.setattr(simulation, "_decide", fail)
    with pytest.raises(KeyboardInterrupt):
        simulation.step()
    assert grids.kept() == before
    assert simulation.field_system.fields["oxygen"].parameters == parameters
    monkeypatch.setattr(simulation, "_decide", real)
    simulation.step()


# --- words -------------------------------------------------------------------------------------


def test_a_tolerance_that_no_grid_reaches_names_the_one_that_can_be():
    described = scene({"oxygen": {**AIR, "tolerance": 1e-7}})
    with pytest.raises(SceneError, match="finer than cells") as caught:
        mc.Simulation(described)
    assert caught.value.path == "nutrients.oxygen.tolerance"
    assert caught.value.exit_code == 2
    reach = float(caught.value.hint.split()[1])
    assert f"{reach:g} mM" in caught.value.problem
    mc.Simulation(described.with_changes({"nutrients.oxygen.tolerance": reach}))
    told = explain(described)
    assert "cannot be chosen: nutrients.oxygen.tolerance: is 1e-07 mM" in str(told["parts"])


def test_the_largest_grid_bounds_it_too(monkeypatch):
    described = scene({"oxygen": {**AIR, "geometry": "box", "tolerance": 1e-4}})
    assert chosen(described)[0].nodes > 10_000
    monkeypatch.setattr("multicell.nutrient.choosing.estimate.MAX_NODES", 6000)
    with pytest.raises(SceneError, match="more than 16777216 nodes") as caught:
        mc.Simulation(described)
    reach = float(caught.value.hint.split()[1])
    choice, _ = chosen(described.with_changes({"nutrients.oxygen.tolerance": reach}))
    assert choice.nodes <= 6000


def test_a_tolerance_that_is_lost_as_the_tissue_grows_is_told():
    finest = scene({"oxygen": {**AIR, "tolerance": 1e-7}})
    with pytest.raises(SceneError) as caught:
        mc.Simulation(finest)
    reach = float(caught.value.hint.split()[1])
    summary = mc.run(finest.with_changes({"nutrients.oxygen.tolerance": reach})).summary()
    assert summary["fields"]["oxygen"]["estimated_error"] > reach
    assert any("finest grid of oxygen has an estimated error" in x for x in summary["notes"])


REFUSED = {
    "two": ({"spacing": 10, "tolerance": 1e-3}, "nutrients.oxygen.tolerance", "beside a spacing"),
    "none": ({"tolerance": 0}, "nutrients.oxygen.tolerance", "above 0"),
    "a length": ({"tolerance": "5 um"}, "nutrients.oxygen.tolerance", "concentration"),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_what_does_not_fit_is_refused(kind):
    table, path, words = REFUSED[kind]
    with pytest.raises(SceneError, match=words) as caught:
        Scene.from_dict({"duration": 3600, "nutrients": {"oxygen": table}})
    assert caught.value.path == path


def test_a_partial_pressure_may_be_the_tolerance():
    made = scene({"oxygen": {**AIR, "tolerance": "1 mmHg"}})
    assert made.nutrients["oxygen"].tolerance == pytest.approx(1.403e-3, rel=1e-3)


def test_explain_tells_what_is_chosen_and_at_what_cost():
    described = scene({"oxygen": {**AIR, "tolerance": 2e-3}}, **{"initial.count": 400})
    choice, _ = chosen(described)
    (words,) = [p["what"] for p in explain(described)["parts"] if p["part"] == "nutrients.oxygen"]
    assert "steady (" in words
    assert f"spherical shells of {choice.spacing:.3g} um" in words
    assert f"{choice.error:.2g} mM, within the tolerance of 0.002 mM" in words
    assert f"{choice.nodes:,} nodes and {choice.iterations} iterations" in words
    assert "instead of cubes of" in words
    many = described.with_changes({"initial.count": 200_000})
    assert "at the start of a run" in str(explain(many)["parts"])


def test_the_estimate_is_of_second_order():
    described = scene(
        {"glucose": {**SUGAR, "spacing": 10, "regime": "steady"}}, **{"initial.count": 150}
    )
    simulation = mc.Simulation(described)
    field, cells = simulation.field_system.fields["glucose"], simulation.cells
    capacity, _ = simulation.field_system.demand_now("glucose", cells)
    load = Load(cells.position, cells.radius, {"glucose": (capacity, None)}, 0.0, 600.0)
    boxes = [{"glucose": on_grid(field.parameters, "box", h)} for h in (16, 8)]
    errors = [spacing_error(field.group, box, load, 20.0)[0] for box in boxes]
    assert 2.0 < errors[0] / errors[1] < 8.0


# --- fields that react -------------------------------------------------------------------------

REACTING = {
    "a": {**AIR, "tolerance": 4e-4},
    "b": {"boundary": 0.4, "diffusion": 900.0, "uptake": 15.0, "half_saturation": 0.05,
          "tolerance": 4e-3},
}  # fmt: skip
BINDING = {"binding": {"rate": "0.5 1/mM/s", "consumes": {"a": 1, "b": 1}}}


@pytest.mark.parametrize("regime", ["steady", "transient"])
def test_fields_that_react_live_on_a_grid_that_does_for_all(regime):
    fields = {name: {**table, "regime": regime} for name, table in REACTING.items()}
    described = scene(fields, reactions=BINDING)
    feeding = mc.Simulation(described).field_system
    first, second = (feeding.grids.choices[name] for name in "ab")
    assert (first.spacing, first.geometry) == (second.spacing, second.geometry)
    assert feeding.fields["a"].layout is feeding.fields["b"].layout
    (group,) = feeding.groups
    cells = mc.Simulation(described).cells
    demand = {name: feeding.demand_now(name, cells) for name in "ab"}
    load = Load(cells.position, cells.radius, demand, 0.0, 1200.0)
    own = {name: field.parameters for name, field in group.fields.items()}
    fine = {name: on_grid(p, "box", first.spacing / 3.0) for name, p in own.items()}
    errors = np.abs(trial(group, own, load).around - trial(group, fine, load).around)
    assert errors.max() <= 4e-4  # those of b are scaled to the tolerance of a
    assert first.error <= 4e-4
    if first.spacing < 19.9:
        assert first.error > 0.1 * 4e-4


def test_fields_that_react_choose_again_and_are_resumed_bit_by_bit(tmp_path):
    fields = {name: {**table, "regime": "transient"} for name, table in REACTING.items()}
    changes = {"duration": "6 h", "growth.cycle_time": "4 h", "output.every": "2 h"}
    whole = mc.run(scene(fields, reactions=BINDING, **changes), output=tmp_path / "a", report=False)
    looked = {frame.progress.grids["a"]["cells"] for frame in whole.frames}
    assert len(looked) > 2
    again = mc.resume(tmp_path / "a", frame=2, output=tmp_path / "b", report=False).frames[-1]
    for name in "ab":
        np.testing.assert_array_equal(
            again.fields[name].values, whole.frames[-1].fields[name].values
        )
    assert whole.summary()["ledger"]["relative_remainder"] < 1e-8


def test_a_tolerance_is_for_all_fields_that_react_or_none():
    without = {key: x for key, x in REACTING["b"].items() if key != "tolerance"}
    words = "is missing, but a, with which it reacts, has one"
    with pytest.raises(SceneError, match=words) as found:
        scene({"a": REACTING["a"], "b": without}, reactions=BINDING)
    assert found.value.path == "nutrients.b.tolerance"
