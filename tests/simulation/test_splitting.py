"""The estimated error of coupling steps beside the true one."""

import functools

import numpy as np
import pytest

import multicell as mc
from multicell.biology import splitting
from multicell.biology.plan import biology_plan
from multicell.cells import State
from multicell.scene.sizes import birth_volume
from multicell.simulation import Simulation

STEPS = (2400.0, 1200.0, 300.0)
BASE = {
    "duration": "12 h",
    "initial": {"count": 8, "spacing": 2.0, "jitter": 0.0},
    "contact": {"law": "hertz"},
    "cells": {"young_variation": 0},
    "growth": {"cycle_time": "20 h", "cycle_variation": 0},
    "integrator": "rkc2",
    "output": {"every": "12 h"},
}
FADING = {
    "boundary": "0.1 mM", "uptake": 0, "media": [["0 h", "0.1 mM"], ["12 h", "0 mM"]],
    "media_change": "linear", "growth_half_saturation": "0.05 mM", "regime": "steady",
    "spacing": "20 um",
}  # fmt: skip
CLOSED = {
    "boundary": "1 mM", "uptake": "1.5 amol/s", "half_saturation": "0.1 mM",
    "growth_half_saturation": "0.3 mM", "regime": "transient", "initial": "medium",
    "sides": {"*": {"type": "derivative", "derivative": 0}}, "time_tolerance": 1e-3,
    "spacing": "20 um",
}  # fmt: skip
BOX = {"x": [-40, 40], "y": [-40, 40], "z": [-40, 40]}
SCENES = {
    "the medium fades": {**BASE, "nutrients": {"oxygen": FADING}},
    "cells use up what there is": {**BASE, "domain": BOX, "nutrients": {"glucose": CLOSED}},
}  # fmt: skip


@functools.cache
def run(name, step):
    return mc.run(mc.Scene.from_dict({**SCENES[name], "coupling_step": step}), threads=1)


def volume(result):
    return float(result.frames[-1].cells.volume.sum())


def estimate(result):
    return result.summary()["splitting"]["relative_volume_error"]


@pytest.mark.parametrize("name", SCENES)
def test_the_estimate_is_the_true_error_within_a_factor_of_two(name):
    finest = run(name, STEPS[-1])
    for step in STEPS[:-1]:
        true = volume(run(name, step)) / volume(finest) - 1.0
        told = estimate(run(name, step)) - estimate(finest)
        assert 0.5 < told / true < 2.0
        assert abs(true) > 1e-3


@pytest.mark.parametrize("name", SCENES)
def test_the_estimate_halves_with_the_step(name):
    coarse, fine = (estimate(run(name, step)) for step in STEPS[:2])
    assert coarse / fine == pytest.approx(2.0, rel=0.15)


def test_cells_that_divide_freely_have_no_error():
    """Daughters have grown since the division was due, whatever the step."""
    free = {**BASE, "duration": "40 h", "initial": {**BASE["initial"], "stage": "uniform"}}
    coarse, fine = (
        mc.run(mc.Scene.from_dict({**free, "coupling_step": step}), threads=1)
        for step in (STEPS[0], STEPS[-1])
    )
    assert len(coarse.frames[-1].cells) > 2 * len(coarse.frames[0].cells)
    assert volume(coarse) == pytest.approx(volume(fine), rel=1e-9)
    assert estimate(coarse) == pytest.approx(0.0, abs=1e-9)


def test_the_estimate_is_the_error_against_a_closed_form():
    """Monod growth in a medium that fades linearly: ∫ c/(K + c) dt is a logarithm."""
    start, half, hours = 0.1, 0.05, 12.0
    fade = start / (hours * 3600.0)
    grown = hours * 3600.0 - half / fade * np.log((half + start) / half)
    birth = 0.5 * 4.0 / 3.0 * np.pi * 5.0**3
    true = 8 * birth * (1.0 + grown / (20 * 3600.0))
    for step in STEPS:
        result = run("the medium fades", step)
        error = volume(result) - true
        # of second order is only what is left
        assert result.summary()["splitting"]["volume_error"] == pytest.approx(error, rel=0.05)


def test_a_field_that_is_used_up_by_more_and_more_cells_has_the_error_that_is_told():
    entries = {
        **BASE, "domain": BOX, "duration": "20 h", "growth": {"cycle_time": "8 h"},
        "initial": {**BASE["initial"], "stage": "uniform"},
        "nutrients": {"glucose": {**CLOSED, "uptake": "0.2 amol/s"}},
    }  # fmt: skip
    entries["growth"]["cycle_variation"] = 0
    results = [
        mc.run(mc.Scene.from_dict({**entries, "coupling_step": s}), threads=1) for s in STEPS
    ]
    held = [
        float(r.frames[-1].fields["glucose"].values.sum())
        * r.frames[-1].fields["glucose"].spacing ** 3
        for r in results
    ]
    told = [
        float(r.history["splitting_content_error_glucose"].sum())
        * r.summary()["ledger"]["glucose"]["content"]
        for r in results
    ]
    for k in range(2):
        ratio = (told[k] - told[2]) / (held[k] - held[2])
        assert 0.5 < ratio < 2.0


def test_a_medium_that_jumps_at_the_end_of_a_step_is_no_error():
    media = [["6 h", "0.02 mM"]]
    field = {**FADING, "media": media, "media_change": "steps"}
    scene = mc.Scene.from_dict({**BASE, "nutrients": {"oxygen": field}, "coupling_step": 2400.0})
    birth = 0.5 * 4.0 / 3.0 * np.pi * 5.0**3
    grown = 6.0 / 20.0 * (0.1 / 0.15 + 0.02 / 0.07)
    result = mc.run(scene, threads=1)
    assert volume(result) == pytest.approx(8 * birth * (1.0 + grown), rel=1e-12)
    assert result.summary()["splitting"]["volume_error"] == 0.0
    # in the middle of a step it is one: here of just half a step
    scene = scene.with_changes({"nutrients.oxygen.media": [["340 min", "0.02 mM"]]})
    result = mc.run(scene, threads=1)
    late = 8 * birth * (1.0 + grown - 1.0 / 60.0 * (0.1 / 0.15 - 0.02 / 0.07))
    error = volume(result) - late
    assert result.summary()["splitting"]["volume_error"] == pytest.approx(error, rel=1e-9)


def test_free_growth_in_phases_has_nothing_to_estimate():
    phases = {"G1": {"duration": "8 h"}, "S": {"duration": "6 h"}, "G2": {"duration": "3 h"},
              "M": {"duration": "1 h", "grows": False}}  # fmt: skip
    scene = mc.Scene.from_dict(
        {**BASE, "duration": "20 h", "growth": {"phases": phases}, "coupling_step": "20 min",
         "initial": {**BASE["initial"], "stage": "uniform"}}
    )  # fmt: skip
    result = mc.run(scene, threads=1)
    assert result.summary()["divisions"] > 4
    # what grows later in phases is the same, and no daughter lacks anything
    assert estimate(result) == pytest.approx(0.0, abs=1e-12)


def test_rms_and_worst_are_those_of_single_cells():
    scene = mc.Scene.from_dict({**SCENES["the medium fades"], "coupling_step": 600.0})
    cells = Simulation(scene, threads=1).cells
    n = len(cells)
    factor = np.linspace(0.1, 0.8, n)
    before = splitting.FrozenRates(cells.id, factor)
    now = splitting.FrozenRates(cells.id, factor - np.linspace(0.0, 0.2, n))
    cells.state[0] = State.NECROTIC
    error = splitting.step_error(biology_plan(scene), before, now, cells, 600.0)
    rate = birth_volume(scene) / cells.cycle_time
    single = 300.0 * rate * np.linspace(0.0, 0.2, n) / cells.volume
    assert error.rms == pytest.approx(np.sqrt(np.mean(single[1:] ** 2)))
    assert error.worst == pytest.approx(single.max())
    assert error.volume == pytest.approx((single * cells.volume).sum())
    # the order of the cells does not matter
    shuffled = np.random.default_rng(1).permutation(n)
    other = splitting.step_error(
        biology_plan(scene),
        splitting.FrozenRates(before.id[shuffled], factor[shuffled]),
        now,
        cells,
        600.0,
    )
    assert other == error


def test_scenes_without_growth_have_no_estimate():
    scene = mc.load_scene("settle").with_changes({"duration": "2 min", "initial.count": 5})
    result = mc.run(scene, threads=1)
    assert "splitting" not in result.summary()
    assert not [name for name in result.history if name.startswith("splitting")]


def test_a_step_that_fails_takes_its_estimate_back(monkeypatch):
    entries = {**SCENES["cells use up what there is"], "coupling_step": "auto"}
    simulation = Simulation(mc.Scene.from_dict(entries), threads=1)
    for _ in range(3):
        simulation.step()

    def state():
        fields = simulation.field_system
        return (
            simulation.time, simulation.splitting, simulation.step_error, simulation.pace,
            dict(fields.content_errors), fields.uptake_error(simulation.scene, 600.0),
        )  # fmt: skip

    kept = state()
    assert kept[1] > 0.0
    estimate = Simulation._estimate

    def fail(self, *given):
        estimate(self, *given)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Simulation, "_estimate", fail)
        with pytest.raises(KeyboardInterrupt):
            simulation.step()
    assert state() == kept
    simulation.step()
    assert state() != kept
