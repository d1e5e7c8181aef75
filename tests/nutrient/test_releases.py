"""Fields that begin as a formula, and amounts that are there at once: closed forms and accounts."""

import numpy as np
import pytest
from running import finished, refused

import multicell as mc
from multicell.errors import SceneError, StepFailed
from multicell.scene.formulas import check_formula, formula_values
from multicell.scene.scene import Scene
from multicell.simulation import Simulation
from multicell.simulation.start_check import check_population

D, LENGTH = 20.0, 160.0
WALLS = {"*": {"type": "derivative", "derivative": 0}}
FIELD = {"diffusion": D, "boundary": 0, "uptake": 0, "regime": "transient", "spacing": "4 um",
         "time_tolerance": 1e-3, "sides": WALLS}  # fmt: skip


def scene_of(field=None, **parts):
    return Scene.from_dict({
        "duration": "10 min", "coupling_step": "1 min", "dimensions": 2,
        "initial": {"count": 4, "spacing": 4.0}, "contact": {"law": "none"},
        "domain": {"x": [-80, 80], "y": [-40, 40]}, "output": {"every": "5 min"},
        "nutrients": {"signal": {**FIELD, **(field or {})}}, **parts,
    })  # fmt: skip


# -- formulas

POINTS = np.array([[1.0, 2.0, 3.0], [-4.0, 0.5, 0.0]])


@pytest.mark.parametrize(("text", "exact"), [
    ("2", [2, 2]), ("x - -y * 2 ** z", [17, -3.5]), ("min(x, y) / max(1, z)", [1 / 3, -4]),
    ("step(x) * sqrt(abs(x)) + pi", [1 + np.pi, np.pi]),
    ("exp(-(x*x + y*y) / 4) + log(2) - sin(x) * cos(y) * tanh(z)",
     np.exp(-np.array([5, 16.25]) / 4) + np.log(2)
     - np.sin([1, -4]) * np.cos([2, 0.5]) * np.tanh([3, 0])),
])  # fmt: skip
def test_formulas_are_worked_out(text, exact):
    np.testing.assert_allclose(formula_values(text, POINTS, "f"), exact, rtol=1e-14)


@pytest.mark.parametrize("text", [
    "", "x +", "t", "x.real", "x[0]", "__import__('os')", "exp(x, y)", "exp(x=1)", "max(x)", "'x'",
    "True", "1j", "x if y else z", "lambda: 1", "[x]", "x < y", "f'{x}'", "min(*x)", "x; y",
    "x @ y",
    "(" * 300 + "x" + ")" * 300, "-" * 100 + "x", "x + " * 300 + "x",
])  # fmt: skip
def test_what_is_no_arithmetic_is_refused(text):
    with pytest.raises(SceneError) as caught:
        check_formula(text, "f")
    assert caught.value.path == "f"


# -- fields that begin as a formula


def test_a_cosine_decays_at_its_rate():
    """c = a (1 + cos(kx) e^(-D k² t)) between walls, k = π/L."""
    scene = scene_of({"initial_formula": f"0.1 * (1 + cos(pi * (x + 80) / {LENGTH}))"})
    run = finished(scene)
    field, k = run.fields["signal"], np.pi / LENGTH
    x = field.axis(0)
    rate = 4 * D / field.spacing**2 * np.sin(0.5 * k * field.spacing) ** 2
    exact = 0.1 * (1 + np.cos(k * (x + 80)) * np.exp(-rate * 600.0))
    np.testing.assert_allclose(field.values[:, 3, 0], exact, rtol=3e-3)
    assert rate == pytest.approx(D * k**2, rel=1e-3)
    assert abs(run.summary()["ledger"]["relative_remainder"]) < 1e-9


def test_values_below_zero_are_named_with_their_place():
    with pytest.raises(
        StepFailed, match=r"initial_formula of signal is -\d.* mM at \(-78, -38, 0\)"
    ):
        Simulation(scene_of({"initial_formula": "x - 50"}))


# -- releases


def spread(x, y, t, place, amount, height, diffusion=1.0):
    """A point source in a plane: a normal distribution of variance 2 D t."""
    square = (x[:, None] - place[0]) ** 2 + (y - place[1]) ** 2
    return amount / (4 * np.pi * diffusion * t * height) * np.exp(-square / (4 * diffusion * t))


@pytest.mark.parametrize("time", ["0 s", "100 s"])
def test_a_release_spreads_as_a_point_source(time):
    release = {"amount": "100 amol", "time": time, "place": [0, 0, 0]}
    wide = {"x": [-80, 80], "y": [-80, 80]}
    scene = scene_of({"release": {"one": release}, "diffusion": 1.0}, domain=wide, duration="4 min")
    run = finished(scene)
    field = run.fields["signal"]
    passed = 240.0 - float(time.split()[0])
    exact = spread(field.axis(0), field.axis(1), passed, (0, 0), 100.0, field.height)
    near = exact > 0.2 * exact.max()
    np.testing.assert_allclose(field.values[:, :, 0][near], exact[near], rtol=0.03)
    ledger = run.summary()["ledger"]["signal"]
    assert ledger["released"] == pytest.approx(100.0, rel=1e-12)
    assert ledger["stored"] == pytest.approx(100.0, rel=1e-6)
    assert ledger["relative_remainder"] < 1e-8
    before = Simulation(scene).summary()["ledger"]["signal"].get("released")
    assert before == (pytest.approx(100.0) if time == "0 s" else None)


def test_cells_of_a_type_share_a_release():
    release = {"amount": "60 amol", "time": "3 min", "type": "donor"}
    table = {"x_um": [-60.0, -20.0, 20.0, 60.0], "y_um": [0.0] * 4,
             "type": ["donor", "other", "donor", "donor"]}  # fmt: skip
    scene = scene_of({"release": {"burst": release}, "diffusion": "0.001 um^2/s"},
                     types={"donor": {}, "other": {}}, duration="4 min")  # fmt: skip
    run = finished(Simulation(scene, cells=table))
    field = run.fields["signal"]
    sums = field.values.sum(axis=(1, 2)).reshape(4, -1).sum(axis=1) * 16.0 * field.height
    np.testing.assert_allclose(sums, [20, 0, 20, 20], atol=1e-3)


def test_runs_with_releases_resume_exactly(tmp_path):
    from stored import assert_same_bits

    release = {"late": {"amount": "50 amol", "time": "5 min", "place": [30, 0, 0], "radius": 6.0},
               "odd": {"amount": "10 amol", "time": "430 s", "place": [60, 10, 0]}}  # fmt: skip
    scene = scene_of({"initial_formula": "0.01 * step(x - 50)", "release": release})
    mc.run(scene, output=tmp_path / "whole", report=False)
    mc.run(scene.with_changes({"duration": "5 min"}), output=tmp_path / "part", report=False)
    mc.resume(tmp_path / "part", changes={"duration": "10 min"}, report=False)
    assert_same_bits(tmp_path / "whole", tmp_path / "part")


@pytest.mark.parametrize(("path", "words", "field"), [
    ("release.a.place", "or a type must be given", {"release": {"a": {"amount": 1.0}}}),
    ("release.a.place", "or a type must be given", {
        "release": {"a": {"amount": 1.0, "place": [0, 0, 0], "type": "x"}}}),
    ("release.a.radius", "no meaning", {"release": {"a": {"amount": 1.0, "type": "x",
                                                          "radius": 3.0}}}),
    ("release.a", "the field is steady", {
        "regime": "steady", "sides": {}, "release": {"a": {"amount": 1.0, "place": [0, 0, 0]}}}),
    ("initial_formula", "the field is steady", {
        "regime": "steady", "sides": {}, "initial_formula": "x"}),
    ("initial_formula", "'q'", {"initial_formula": "x + q"}),
    ("initial", "there is an initial_formula", {"initial": "steady", "initial_formula": "x"}),
])  # fmt: skip
def test_refusals(path, words, field):
    with refused(f"nutrients.signal.{path}", words):
        scene_of(field)


def test_a_release_outside_the_domain_is_refused_whenever_it_is():
    release = {"amount": 1.0, "time": "1 min", "place": [-85, 0, 0]}
    with refused("nutrients.signal.release.a.place", "outside the domain"):
        scene_of({"release": {"a": release}})


def test_a_release_that_the_grid_does_not_reach_in_time_ends_the_run():
    release = {"amount": 1.0, "time": "1 min", "place": [500, 0, 0]}
    run = Simulation(scene_of({"release": {"a": release}}, domain=None))
    with pytest.raises(StepFailed, match=r"release.a of signal at 60 s has no place"):
        finished(run)


FIRST = {
    "negative": ({"initial_formula": "x - 50"}, "initial_formula", "is -"),
    "no number": ({"initial_formula": "log(x)"}, "initial_formula", "is nan"),
    "too large": ({"initial_formula": "9**9**9**9"}, "initial_formula", "is inf"),
    "nowhere": ({"release": {"a": {"amount": 1.0, "place": [500, 0, 0]}}}, "release.a.place",
                "outside the grid"),
    "of nobody": ({"release": {"a": {"amount": 1.0, "type": "b"}}}, "release.a.type", "no cell"),
}  # fmt: skip


@pytest.mark.parametrize("case", FIRST)
def test_what_no_run_could_begin_with_is_refused_before_it(case):
    field, path, words = FIRST[case]
    types = {"types": {"a": {}, "b": {"fraction": 0}}} if case == "of nobody" else {}
    domain = {"domain": None} if case == "nowhere" else {}
    with refused(f"nutrients.signal.{path}", words):
        check_population(scene_of(field, **types, **domain))


def test_a_good_start_is_not_refused():
    field = {"initial_formula": "1 + x / 100",
             "release": {"a": {"amount": 1.0, "place": [70, -30, 0], "radius": 3.0}}}  # fmt: skip
    check_population(scene_of(field))


@pytest.mark.parametrize("number", ["9" * 500, "1e400", "-1e999", "2 * 1" + "0" * 400])
def test_numbers_beyond_computing_are_refused(number):
    with refused("nutrients.signal.initial_formula", "too large to compute with"):
        scene_of({"initial_formula": number})


def test_oxygen_begins_with_no_more_than_dissolves():
    field = {**FIELD, "initial_formula": "21 * step(x)"}
    scene = Scene.from_dict({**scene_of().to_dict(), "nutrients": {"oxygen": field}})
    for door in (check_population, Simulation):
        with refused("nutrients.oxygen.initial_formula", "21 mM, but under pure oxygen"):
            door(scene)
