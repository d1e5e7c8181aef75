"""A finite medium that the cells use up, against closed forms and its own account."""

import numpy as np
import pytest
from running import finished, refused
from scipy.special import lambertw

import multicell as mc
from multicell.errors import SceneError, StepFailed
from multicell.report.explain.scene import explain
from multicell.scene.scene import Scene

WALL = {"type": "derivative", "derivative": 0.0}
WELL = {axis: [-250.0, 250.0] for axis in "xyz"}
CHANGES = [["50 min", 4.0], ["100 min", 5.5], ["150 min", 3.0]]


def scene(nutrient=None, **changes):
    entries = {
        "duration": "160 min",
        "coupling_step": "20 min",
        "initial": {"count": 60, "stage": "uniform"},
        "contact": {"law": "hertz"},
        "nutrients": {
            "glucose": {
                "diffusion": 600.0, "boundary": 5.0, "uptake": 200.0, "half_saturation": 0.05,
                "finite_medium": {"volume": 2.5e8}, "media": CHANGES, **(nutrient or {}),
            }
        },
    }  # fmt: skip
    return Scene.from_dict(entries).with_changes(changes)


def closed(simulation, begin, name="glucose"):
    """Return the missing part in field, medium and cells together, over all that was brought."""
    ledger, held = simulation.ledger[name], content(simulation, name)
    brought = begin + ledger.fresh + ledger.secreted
    gone = ledger.discarded + ledger.spoiled + ledger.decayed + ledger.uptake
    return abs(brought - gone - ledger.held - held) / (begin + ledger.fresh)


def content(simulation, name="glucose"):
    """Return the content of the last frame's field, amol, by its own grid."""
    field = simulation.fields[name]
    if field.kind == "radial":
        edges = np.arange(field.values.size + 1) * field.spacing
        return float(np.sum(field.values.ravel() * np.diff(edges**3)) * 4.0 * np.pi / 3.0)
    return float(field.values.sum()) * field.spacing**2 * (field.height or field.spacing)


# --- closed forms ------------------------------------------------------------------------------


@pytest.mark.parametrize("regime", ["steady", "transient"])
def test_a_mixed_medium_is_used_up_as_lambert_s_function_says(regime):
    """V dc/dt = -n q c/(K + c) where diffusion is quick: c = K W(c_0/K exp((c_0 - n q t/V)/K))."""
    nutrient = {
        "diffusion": 1e7, "regime": regime, "half_saturation": 1.5,
        "spacing": 20.0, "uptake": 3000.0,
    }  # fmt: skip
    changes = {"nutrients.glucose.media": None, "duration": "3 h", "coupling_step": "1 h"}
    described = scene(nutrient).with_changes(changes)

    def check(simulation):
        time, k = simulation.time, 1.5
        fallen = (5.0 - 60 * 3000.0 * time / 2.5e8) / k
        exact = k * lambertw(5.0 / k * np.exp(fallen)).real
        found = simulation.history_row()["medium_glucose"]
        assert found == pytest.approx(exact, rel=2e-3)
        np.testing.assert_allclose(simulation.concentrations["glucose"], exact, rtol=4e-3)

    simulation = finished(described, check)
    assert simulation.history_row()["medium_glucose"] < 2.5


def test_what_a_change_leaves_and_brings():
    described = scene(
        {"uptake": 0.0, "regime": "transient", "spacing": 20.0,
         "finite_medium": {"volume": 1.6e7, "replaced": 0.4}, "media": [["20 min", 0.0]]},
        domain={axis: [-100.0, 100.0] for axis in "xyz"}, duration="60 min",
        coupling_step="10 min",
    )  # fmt: skip
    simulation = mc.Simulation(described)
    for _ in range(2):
        simulation.step()
    # at the moment of the change: the stirred half is 0.6 of what it was
    assert simulation.history_row()["medium_glucose"] == pytest.approx(3.0)
    assert simulation.ledger["glucose"].discarded == pytest.approx(0.4 * 5.0 * 0.8e7)
    finished(simulation)
    # long after it: all of it is mixed
    assert simulation.history_row()["medium_glucose"] == pytest.approx(4.0, rel=1e-3)


# --- the account -------------------------------------------------------------------------------

PLACES = {
    "a well": {
        "domain": {axis: [-160.0, 160.0] for axis in "xyz"},
        "nutrients.glucose.spacing": 20.0,
        "coupling_step": "40 min",
    },
    "shells": {"nutrients.glucose.geometry": "radial", "growth": {"cycle_time": "8 h"}},
    "a plane": {
        "dimensions": 2,
        "nutrients.glucose.height": "10 um",
        "nutrients.glucose.finite_medium.volume": 5e7,
        "coupling_step": "40 min",
    },
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("place", "regime"),
    [*((place, "transient") for place in PLACES), ("shells", "steady")],
)
def test_medium_field_and_cells_hold_what_was_brought(place, regime):
    described = scene({"regime": regime, "spacing": 20.0}, **PLACES[place])
    simulation = mc.Simulation(described)
    begin, levels = content(simulation), []

    def check(run):
        levels.append(run.history_row()["medium_glucose"])
        assert closed(run, begin) <= 1e-8

    finished(simulation, check)
    ledger = simulation.ledger["glucose"]
    assert ledger.changes == 3
    assert ledger.relative_remainder <= 1e-8
    assert ledger.uptake > 0.0
    assert ledger.discarded > 0.0
    assert np.diff(levels).min() < 0.0  # used up
    summary = simulation.summary()
    assert summary["fields"]["glucose"]["medium"] == levels[-1]
    assert summary["ledger"]["glucose"]["medium_held"] == ledger.held
    assert summary["units"]["ledger.glucose.medium_fresh"] == "amol"


@pytest.mark.parametrize("regime", ["steady", "transient"])
def test_the_account_holds_with_decay_perfusion_secretion_and_part_changes(regime):
    described = scene(
        {"regime": regime, "decay": 1e-4, "perfusion": 1e-4, "secretion": 60.0, "spacing": 20.0,
         "finite_medium": {"volume": 3e7, "replaced": 0.5}},
        growth={"cycle_time": "8 h"}, death={},
    )  # fmt: skip
    simulation = mc.Simulation(described)
    begin = content(simulation)
    finished(simulation)
    ledger = simulation.ledger["glucose"]
    assert closed(simulation, begin) <= 1e-8
    assert ledger.relative_remainder <= 1e-8
    assert min(ledger.spoiled, ledger.decayed, ledger.washed, ledger.secreted) > 0.0


def test_a_true_imbalance_of_the_medium_shows():
    ledger = finished(scene({"regime": "steady"})).ledger["glucose"]
    assert ledger.relative_remainder < 1e-8
    ledger.held *= 0.999
    assert ledger.relative_remainder > 1e-5


@pytest.mark.parametrize("regime", ["steady", "transient"])
def test_a_medium_that_is_eaten_up_ends_at_nothing_and_not_below(regime):
    described = scene(
        {"regime": regime, "uptake": 2000.0, "half_saturation": 0.05, "spacing": 20.0,
         "media": [["40 min", 1.0]], "finite_medium": {"volume": 1.6e7}},
        domain={axis: [-80.0, 80.0] for axis in "xyz"}, duration="60 min",
    )  # fmt: skip
    least = []

    def check(simulation):
        least.append(min(simulation.fields["glucose"].values.min(),
                         simulation.ledger["glucose"].held))  # fmt: skip

    begin = content(mc.Simulation(described))
    simulation = finished(described, check)
    ledger = simulation.ledger["glucose"]
    assert min(least) >= 0.0
    assert closed(simulation, begin) <= 1e-8
    assert simulation.history_row()["medium_glucose"] < 0.05
    assert ledger.uptake > 0.9 * (begin + ledger.fresh)


@pytest.mark.parametrize("regime", ["steady", "transient"])
def test_a_level_at_the_bound_of_scene_files_may_rise_beyond_it(regime):
    described = scene(
        {"regime": regime, "boundary": 1e5, "secretion": 1e3, "uptake": 0.0,
         "media": [["1 s", 1e5]], "spacing": 20.0, "finite_medium": {"volume": 1e8}},
        duration="20 min",
    )  # fmt: skip
    assert finished(described).history_row()["medium_glucose"] > 1e5


def test_every_change_is_done_once_whatever_rounding_makes_of_times():
    step = 0.7
    media = [[step * k, 1.0 + k] for k in (3, 6, 7, 12)]
    described = scene({"media": media, "regime": "steady", "spacing": 20.0}, coupling_step=step,
                      duration=20 * step)  # fmt: skip
    assert finished(described).ledger["glucose"].changes == 4
    assert finished(scene({"media": [[0.0, 2.0], ["1 h", 3.0]]})).ledger["glucose"].changes == 2


def test_explain_says_how_long_the_medium_lasts():
    told = explain(scene({"finite_medium": {"volume": "0.25 uL"}}))
    lasts = next(n for n in told["numbers"] if n["name"] == "glucose: medium lasts")
    assert lasts["value"] == pytest.approx(2.5e8 * 5.5 / (60 * 200.0))


REFUSED = {
    "another supply": ({"sides": {"x-": {"value": 3.0}}}, "sides.x-.value", "elsewhere"),
    "a slope": ({"sides": {"y": {"type": "derivative", "derivative": 1e-4}}},
                "sides.y.derivative", "elsewhere"),
    "walls": ({"sides": {"*": WALL}, "regime": "transient"}, "finite_medium", "touches no side"),
    "a course": ({"media_change": "linear"}, "media_change", "finite medium"),
    "no volume": ({"finite_medium": {}}, "finite_medium.volume", "missing"),
    "too much": ({"finite_medium": {"volume": 1e9, "replaced": 1.5}}, "finite_medium.replaced",
                 "at most 1"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_refused_in_words(case):
    nutrient, path, words = REFUSED[case]
    with refused(f"nutrients.glucose.{path}", words):
        scene(nutrient)


def test_a_medium_smaller_than_its_grid_is_refused():
    with pytest.raises(SceneError, match="no more than the domain"):
        scene(domain=WELL, **{"nutrients.glucose.finite_medium.volume": 1.25e8})
    with pytest.raises(StepFailed, match="nothing is left that could be stirred"):
        mc.Simulation(scene(**{"nutrients.glucose.finite_medium.volume": 1e5}))


@pytest.mark.slow
@pytest.mark.parametrize("regime", ["steady", "transient"])
def test_a_medium_far_larger_than_its_field_leaves_no_rounding_in_the_account(regime):
    """Decay in the field, and loss by flow, are not differences of large numbers."""
    changes = {
        "nutrients.glucose.finite_medium": {"volume": 1e13},
        "nutrients.glucose.regime": regime, "nutrients.glucose.decay": 3e-4,
        "nutrients.glucose.perfusion": 3e-3,
    }  # fmt: skip
    simulation = finished(scene().with_changes(changes))
    ledger = simulation.ledger["glucose"]
    assert ledger.relative_remainder <= 1e-8
    assert ledger.washed > 0.0
    assert ledger.decayed > 0.0


@pytest.mark.slow
@pytest.mark.parametrize("regime", ["transient", "steady"])
def test_fields_with_a_finite_medium_react_and_no_molecule_is_lost(regime):
    """A drug in a finite medium binds another one, and what they make leaves."""
    fields = {
        "a": {"boundary": 0.1, "uptake": 1.0, "finite_medium": {"volume": 2e7}},
        "b": {"boundary": 0.05, "uptake": 0.0, "decay": 1e-5, "media": [[900.0, 0.08]]},
        "c": {"boundary": 0.0, "uptake": 0.0},
    }  # fmt: skip
    common = {"diffusion": 500.0, "spacing": 20.0, "regime": regime}
    run = finished(
        Scene.from_dict({
            "duration": 1800.0, "coupling_step": 600.0, "initial": {"count": 5},
            "nutrients": {name: {**common, **entries} for name, entries in fields.items()},
            "reactions": {"bind": {
                "rate": "0.05 1/(mM s)", "consumes": {"a": 1, "b": 1}, "produces": {"c": 1},
            }},
        })
    )  # fmt: skip
    ledger = run.ledger
    for name in fields:
        assert ledger[name].relative_remainder < 1e-6
    used = [ledger["a"].used, ledger["b"].used, ledger["c"].made]
    np.testing.assert_allclose(used, used[0], rtol=1e-6)
    assert ledger["a"].fresh > 0.0
    assert ledger["a"].level * 2e7 < ledger["a"].fresh + 0.1 * 2e7
    assert ledger["a"].level < 0.1
    assert ledger["a"].uptake > 0.0
    assert ledger["a"].used > 0.0
    both = {"nutrients.b.finite_medium": {"volume": 3e7}}
    with pytest.raises(SceneError, match="with which it reacts, has one already"):
        run.scene.with_changes(both)
