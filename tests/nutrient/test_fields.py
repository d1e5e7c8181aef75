"""Whole runs with several fields: dependences, ledgers, media, geometries, wrong input."""

from dataclasses import replace

import numpy as np
import pytest
from running import refused
from scipy import integrate

import multicell as mc
from multicell.nutrient.balls import OnShells
from multicell.nutrient.cartesian import departure, round_enough
from multicell.nutrient.field import NutrientField
from multicell.nutrient.fitness import discretisation_error
from multicell.nutrient.grid import BoxLayout, ShellLayout, restored
from multicell.nutrient.parameters import FieldParameters
from multicell.nutrient.spherical import Shells
from multicell.scene.scales import largest_spacing, regime
from multicell.scene.scene import Scene
from multicell.simulation import Simulation

THREE = {
    "lactate": {
        "diffusion": 600.0, "boundary": 0.0, "uptake": 0.0, "decay": "1e-3 1/s",
        "secretion": "2 amol/s", "secretion_from": {"glucose": 1.8}, "growth_inhibition": 8.0,
    },
    "oxygen": {
        "boundary": 0.05, "uptake": 40.0, "quiescence": 0.015, "necrosis": 0.008,
        "growth_half_saturation": 0.01, "uptake_on": {"glucose": {"effect": 1.5, "half": 0.4}},
    },
    "glucose": {
        "diffusion": 105.0, "diffusion_medium": 650.0, "boundary": 1.0, "uptake": 60.0,
        "half_saturation": 0.04, "quiescence": 0.06, "perfusion": "2e-4 1/s",
    },
}  # fmt: skip


def scene(**changes):
    entries = {
        "duration": "10 h",
        "coupling_step": "20 min",
        "initial": {"count": 60, "stage": "uniform", "spacing": 0.9},
        "contact": {"law": "jkr", "surface_energy": 0.02},
        "growth": {"cycle_time": "10 h"},
        "death": {"lysis_time": "5 h"},
        "nutrients": THREE,
        "integrator": "ab2-adaptive",
    }
    return Scene.from_dict(entries).with_changes({k.replace("__", "."): v for k, v in
                                                  changes.items()})  # fmt: skip


PASTEUR = {"oxygen": {"effect": 1.0, "half": "0.02 mM"}}
"""Uptake of glucose rises where oxygen is short, and that of oxygen where glucose is."""


def everywhere(key, value):
    return {f"nutrients.{name}.{key}": value for name in THREE}


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {**everywhere("regime", "transient"), **everywhere("geometry", "radial")},
        {"nutrients.glucose.regime": "transient", "nutrients.oxygen.geometry": "auto"},
        {"nutrients.glucose.uptake_on": PASTEUR, **everywhere("regime", "transient")},
        {"dimensions": 2, **everywhere("height", "10 um"), **everywhere("regime", "transient")},
    ],
)
def test_every_molecule_is_accounted_for_while_cells_divide(changes):
    result = mc.run(scene(**changes))
    summary = result.summary()
    assert summary["divisions"] > 10
    for name in THREE:
        ledger = summary["ledger"][name]
        assert ledger["relative_remainder"] <= 1e-8
        assert np.min(result.frames[-1].fields[name].values) >= 0.0
    assert summary["ledger"]["lactate"]["secreted"] > summary["ledger"]["glucose"]["uptake"]
    assert summary["ledger"]["lactate"]["decayed"] > 0.0


def test_secretion_from_uptake_is_its_share_of_it():
    simulation = mc.Simulation(scene(nutrients__lactate__secretion=0.0))
    simulation.step()
    made = simulation.ledger["lactate"].secreted
    assert made == pytest.approx(1.8 * simulation.ledger["glucose"].uptake, rel=1e-9)


@pytest.mark.parametrize("kind", ["steady", "transient"])
def test_the_medium_is_switched_in_time(kind):
    media = [["130 min", "0.2 mM"], ["250 min", "0.01 mM"]]
    described = scene(
        duration="6 h",
        growth=None,
        death=None,
        output__every="20 min",
        nutrients={"oxygen": {"boundary": 0.05, "media": media, "uptake": 1.0, "regime": kind}},
    )
    frames = mc.run(described).frames
    level = [frame.fields["oxygen"].values.max() for frame in frames]
    expected = [0.05 if f.time < 7800 else 0.2 if f.time < 15000 else 0.01 for f in frames]
    np.testing.assert_allclose(level, expected, rtol=0.02)


def test_the_medium_may_change_linearly():
    nutrient = scene(
        nutrients__oxygen__media=[[100.0, 0.1], [300.0, 0.5]],
        nutrients__oxygen__media_change="linear",
    ).nutrients["oxygen"]
    found = [nutrient.medium(t) for t in (0.0, 50.0, 100.0, 200.0, 400.0)]
    np.testing.assert_allclose(found, [0.05, 0.075, 0.1, 0.3, 0.5])
    assert nutrient.switches(50.0, 300.0) == [100.0]
    stepped = scene(nutrients__oxygen__media=[[100.0, 0.1], [300.0, 0.5]]).nutrients["oxygen"]
    assert [stepped.medium(t) for t in (0.0, 99.0, 100.0, 299.0, 300.0)] == [0.05, 0.05, 0.1, 0.1,
                                                                             0.5]  # fmt: skip


def test_shells_and_box_agree_for_a_ball_of_cells():
    changes = {"growth": None, "death": None, "initial.count": 400}
    box = mc.Simulation(scene(**changes)).concentrations["oxygen"]
    radial = mc.Simulation(scene(**changes, **everywhere("geometry", "radial")))
    np.testing.assert_allclose(radial.concentrations["oxygen"].mean(), box.mean(), rtol=0.015)


def test_auto_takes_shells_for_a_ball_and_a_box_for_two_balls():
    auto = everywhere("geometry", "auto")
    ball = mc.Simulation(scene(**auto, initial__count=300))
    assert {field.kind for field in ball.fields.values()} == {"radial"}
    cells = ball.cells.take(np.arange(len(ball.cells)))
    cells.position[cells.position[:, 0] > 0.0, 0] += 100.0
    two = mc.Simulation(scene(**auto, initial__count=300), cells=cells)
    assert {field.kind for field in two.fields.values()} == {"box"}


@pytest.mark.parametrize(
    ("geometry", "finest", "spacing"), [("radial", 8, 20.0), ("radial", 8, 14.0), ("box", 4, 20.0)]
)
def test_the_estimated_error_of_the_grid_is_that_against_a_finer_one(geometry, finest, spacing):
    described = mc.load_scene("spheroid").with_changes(
        {"initial.count": 2000, "initial.spacing": 0.9, "nutrients.oxygen.geometry": geometry,
         "nutrients.oxygen.spacing": spacing}
    )  # fmt: skip
    cells = Simulation(described).cells
    capacity = np.full(len(cells), 40.0)
    parameters = FieldParameters.of(described, "oxygen")
    found = []
    for h in (spacing, spacing / finest):
        field = NutrientField("oxygen", replace(parameters, spacing=h))
        field.solve(cells.position, capacity, radius=cells.radius)
        found.append((field, field.sample(cells.position)))
    (field, coarse), (_, fine) = found
    true = np.abs(coarse - fine).max()
    kept = field.field().values.tobytes()
    estimate = discretisation_error(field, parameters, cells, capacity, None, 0.0)
    assert 0.4 * true < estimate < 2.5 * true
    assert field.field().values.tobytes() == kept
    transient = replace(parameters, regime="transient")
    assert discretisation_error(field, transient, cells, capacity, None, 0.0) is None


def test_the_summary_tells_what_each_field_lives_on():
    run = mc.run(scene(duration="1 h", **{"nutrients.oxygen.geometry": "radial",
                                          "nutrients.oxygen.regime": "transient"}))  # fmt: skip
    fields = run.summary()["fields"]
    assert fields["oxygen"]["geometry"] == "shells"
    assert fields["lactate"]["geometry"] == "cubes"
    assert 0.0 < fields["lactate"]["discretisation_error"] < 0.1
    assert "discretisation_error" not in fields["oxygen"]
    assert 0.0 <= fields["oxygen"]["departure_from_a_ball"] < 1.0
    last = run.frames[-1].cells
    expected = departure(last.position, last.radius)
    assert fields["oxygen"]["departure_from_a_ball"] == expected
    plane = {**everywhere("height", "10 um"), "nutrients.oxygen.geometry": "auto"}
    flat = mc.run(scene(duration="20 min", dimensions=2, **plane))
    assert {field["geometry"] for field in flat.summary()["fields"].values()} == {"squares"}


def test_a_radial_field_says_when_the_tissue_is_no_ball():
    described = scene(duration="20 min", **everywhere("geometry", "radial"))
    assert "notes" not in mc.run(described).summary()
    simulation = Simulation(described)
    stretched = simulation.cells.take(np.arange(60))
    stretched.position[:, 0] *= 2.0
    pulled = Simulation(described, cells=stretched)
    notes = pulled.summary()["notes"]
    assert len(notes) == 3
    assert "oxygen lives on spherical shells" in "".join(notes)
    assert "more than 0.1" in notes[0]


def test_departure_of_ellipsoids_is_that_of_their_axes():
    rng = np.random.default_rng(5)
    points = rng.normal(size=(20000, 3))
    points *= rng.random((20000, 1)) ** (1 / 3) / np.linalg.norm(points, axis=1, keepdims=True)
    size = np.full(20000, 1e-3)
    for axes in ((1.0, 1.0, 1.0), (2.0, 1.0, 1.0), (4.0, 2.0, 1.0)):
        found = departure(100.0 * points * axes, size)
        assert found == pytest.approx(1.0 - min(axes) / max(axes), abs=0.03)
    assert round_enough(100.0 * points * (1.1, 1, 1), size, now_radial=True)
    assert not round_enough(100.0 * points * (1.1, 1, 1), size, now_radial=False)


def boxes():
    position = np.random.default_rng(6).normal(0.0, 30.0, (200, 3))
    yield BoxLayout.round(position, 40.0, 9.0, None)
    yield BoxLayout.round(1.1 * position + 3.0, 40.0, 9.0, None)
    yield BoxLayout.round(position, 40.0, 9.0, 12.0)
    yield BoxLayout.round(1.1 * position + 3.0, 40.0, 9.0, 12.0)
    yield ShellLayout.round(position, np.ones(200), 40.0, 9.0)
    yield ShellLayout.round(1.2 * position, np.ones(200), 40.0, 9.0)


@pytest.mark.parametrize("k", [0, 2, 4])
def test_a_grid_that_is_laid_anew_takes_over_every_molecule(k):
    old, new = list(boxes())[k : k + 2]
    values = np.random.default_rng(7).random(old.filled(0.0).shape)
    there = new.carried(values, old, 0.5)
    assert values.min() <= there.min() <= there.max() <= values.max()
    # all that was inside is there, if nothing comes from outside
    bare = new.carried(values, old, 0.0)
    if k != 2:
        assert np.sum(new.volumes * bare) <= np.sum(old.volumes * values) * (1 + 1e-12)
    inner = old.carried(new.carried(np.ones_like(values), old, 1.0), new, 1.0)
    np.testing.assert_allclose(inner, 1.0, rtol=1e-12)


@pytest.mark.parametrize("k", range(6))
def test_what_cells_put_in_is_there_and_frames_restore_it(k):
    layout = list(boxes())[k]
    rng = np.random.default_rng(8)
    position, amount = rng.normal(0.0, 15.0, (50, 3)), rng.random(50)
    density = layout.scatter(position, amount)
    assert np.sum(layout.volumes * density) == pytest.approx(amount.sum(), rel=1e-12)
    values = rng.random(density.shape)
    again, back = restored(layout.field("oxygen", values))
    np.testing.assert_array_equal(back, values)
    np.testing.assert_array_equal(again.gather(position, back), layout.gather(position, values))


def test_uptakes_that_depend_on_each_other_are_those_of_two_coupled_equations():
    """A ball in its layer against SciPy's boundary value problem."""
    radius, medium = 370.0, np.array([0.2, 5.5])
    scene = mc.load_scene("emt6-rim").with_changes(
        {"energy.necrosis": None, "energy.quiescence": 1e-9, "nutrients.lactate": None}
    )
    simulation = mc.Simulation(scene, threads=1)
    cells, found = simulation.cells, simulation.concentrations
    o, g = scene.nutrients["oxygen"], scene.nutrients["glucose"]
    e, f, layer = o.uptake_on["glucose"], g.uptake_on["oxygen"], o.layer
    share = float(cells.volume.sum()) / (4.0 / 3.0 * np.pi * radius**3)
    inside, outside = (np.array([getattr(x, k) for x in (o, g)])
                       for k in ("diffusion", "diffusion_medium"))  # fmt: skip
    resist = (1.0 / radius - 1.0 / (radius + layer)) * radius**2 / outside

    def slope(r, y):
        c = np.maximum(y[:2], 0.0)
        taken = np.array([
            o.uptake_per_volume * (1 + e.effect * e.half / (e.half + c[1]))
            * c[0] / (o.half_saturation + c[0]),
            g.uptake_per_volume * (1 + f.effect * f.half / (f.half + c[0]))
            * c[1] / (g.half_saturation + c[1]),
        ])  # fmt: skip
        return np.concatenate([y[2:], share * taken / inside[:, None] - 2.0 * y[2:] / r])

    def ends(inner, outer):
        return np.concatenate([inner[2:], outer[:2] + resist * inside * outer[2:] - medium])

    r = np.linspace(1.0, radius, 400)
    guess = np.concatenate([medium[:, None] * (r / radius) ** 2, np.zeros((2, len(r)))])
    exact = integrate.solve_bvp(slope, ends, r, guess, tol=1e-6, max_nodes=100_000)
    assert exact.success
    depth = radius - np.linalg.norm(cells.position - cells.position.mean(axis=0), axis=1)
    for k, name in enumerate(("oxygen", "glucose")):
        there = exact.sol(radius - depth)[k]
        off = np.abs(found[name] - there)[depth < 200.0].max() / medium[k]
        assert off < 0.03


def test_scales_and_choices():
    described = scene()
    assert regime(described, "oxygen") == "steady"
    assert regime(scene(nutrients__glucose__diffusion=1.0), "glucose") == "transient"
    # where nothing comes in there is no level to be at rest at
    assert regime(scene(nutrients__oxygen__sides=WALLS), "oxygen") == "transient"
    assert 5.0 <= largest_spacing(described, "glucose") <= 10.0


WALLS = {"*": {"type": "derivative", "derivative": 0}}
ON = {"effect": 1, "half": 1}


@pytest.mark.parametrize(
    ("changes", "path", "words"),
    [
        ({"oxygen.regime": "steady", "oxygen.sides": WALLS}, "oxygen.sides", "fix no level"),
        ({"oxygen.uptake_on.glucos": ON}, "oxygen.uptake_on.glucos", "Did you mean 'glucose'"),
        ({"oxygen.secretion_from.lactat": 1}, "oxygen.secretion_from.lactat", "mean 'lactate'"),
        ({"glucose.uptake_on": {"glucose": ON}}, "glucose", "depends on itself"),
        ({"glucose.uptake_on": {"lactate": ON}}, "lactate", "depends on itself"),
        ({"oxygen.media": [["2 h", 0.1], ["1 h", 0.2]]}, "oxygen.media", "times that rise"),
        ({"oxygen.media": [["2 h", "1 um"]]}, "oxygen.media", "concentration"),
        ({"oxygen.boundary": "__import__('os')"}, "oxygen.boundary", "a number and a unit"),
        ({"oxygen.sides": {"x-": {"value": "sin(x)"}}}, "oxygen.sides.x-.value", "a number and"),
        (
            {"oxygen.sides": {"x-": {"type": "derivative"}}},
            "oxygen.sides.x-.derivative",
            "is missing",
        ),
        ({"oxygen.sides": {"w+": {"value": 1}}}, "oxygen.sides.w+", "not a known name"),
        (
            {"oxygen.geometry": "radial", "oxygen.sides": {"x-": {"value": 1}}},
            "oxygen.sides.x-",
            "does not exist on a radial grid",
        ),
    ],
)
def test_wrong_input_is_named(changes, path, words):
    with refused(f"nutrients.{path}", words):
        scene().with_changes({f"nutrients.{key}": value for key, value in changes.items()})


@pytest.mark.parametrize(("key", "value"), [("sides.z+", {"value": 1}), ("geometry", "radial")])
def test_a_plane_has_neither_depth_nor_shells(key, value):
    with refused(f"nutrients.oxygen.{key}", "2 dimensions"):
        scene().with_changes({"dimensions": 2, f"nutrients.oxygen.{key}": value})


def test_fields_that_depend_on_each_other_weigh_cells_once_a_step(monkeypatch):
    run = mc.Simulation(mc.load_scene("emt6").with_changes({"initial.count": 30}))
    weighed, solved = [], []
    weigh, solve = OnShells.at, Shells.solve
    monkeypatch.setattr(OnShells, "at", lambda *given: weighed.append(1) or weigh(*given))
    monkeypatch.setattr(
        Shells, "solve", lambda *given, **more: solved.append(1) or solve(*given, **more)
    )
    run.step()
    assert len(solved) >= 7  # three fields, and two turns of two of them or more
    assert len(weighed) == 3  # on the last grid and on the next, and as tissue there
