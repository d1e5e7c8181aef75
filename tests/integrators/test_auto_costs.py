"""The model of costs that ``auto`` chooses by, and what a run learns."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from strategies import cluster, mechanics

import multicell as mc
from multicell.integrators import auto, costs
from multicell.integrators.auto import CANDIDATES, Auto, measured_rate
from multicell.integrators.base import Outcome
from multicell.integrators.costs import CouplingStep, Learnt
from multicell.mechanics.decay_rate import GLANCED, spectrum_ends
from multicell.mechanics.jacobian import sparse_jacobian
from multicell.scene.scene import Scene
from multicell.simulation import Simulation

MIDDLE = CouplingStep(300.0, 5.0, 0.1, 200, python=False)
NUMBER = {name: k for k, name in enumerate(CANDIDATES)}


def test_the_model_has_its_limits():
    """Work as stability alone asks for, as √(λΔt), and less of it at looser tolerances."""
    still = MIDDLE._replace(motion=0.0, stiffness=1e6)
    constants = costs.constants()
    for name in ("ab2-adaptive", "rk4-adaptive"):
        assert still.work(name) == pytest.approx(constants[name]["rate"] * 1e6, rel=1e-3)
    four = still._replace(stiffness=4e6).work("rkc2") / still.work("rkc2")
    assert 1.7 < four < 2.0
    for name in CANDIDATES:
        works = [MIDDLE._replace(tolerance=tol).work(name) for tol in (1.0, 0.1, 0.01, 1e-3)]
        assert works == sorted(works)
        finer = MIDDLE._replace(tolerance=0.01).work(name)
        assert MIDDLE.work(name, 0.1) == pytest.approx(finer, rel=1e-12)
        assert MIDDLE._replace(stiffness=0.0, motion=0.0).work(name) > 0.0


def test_motion_counts_in_tolerances():
    """The same motion at the same number of tolerances, in µm or in nm, costs the same."""
    small = MIDDLE._replace(motion=1e-3 * MIDDLE.motion, tolerance=1e-3 * MIDDLE.tolerance)
    for name in CANDIDATES:
        assert small.work(name) == pytest.approx(MIDDLE.work(name), rel=1e-12)


def test_a_pass_costs_its_calls_with_few_cells():
    constants = costs.constants()
    for name in CANDIDATES:
        many, few = (MIDDLE._replace(cells=n).unit(name) for n in (10**9, 1))
        assert many == pytest.approx(constants[name]["cell"], rel=1e-5)
        assert few == constants[name]["cell"] + constants[name]["call"]
        slow = MIDDLE._replace(python=True).unit(name)
        assert slow == constants[name]["cell"] + constants[name]["python"] / 200


def test_the_ends_of_the_spectrum_are_those_of_the_matrix():
    position, radius, young = cluster(150, 2, spacing=0.9)
    system = mechanics(radius, young, duration=60.0)
    decay, residual, growth = spectrum_ends(system, 0.0, position)
    work = vars(system.work).copy()
    values = np.linalg.eigvals(sparse_jacobian(system).toarray()).real
    assert work["jacobian_products"] == GLANCED
    assert decay <= -values.min() * (1.0 + 1e-12)
    assert 0.97 < (decay + residual) / -values.min() < 1.15
    assert growth <= values.max() + 1e-12
    alone = mechanics(np.array([5.0]), np.array([1.0]))
    assert spectrum_ends(alone, 0.0, np.zeros((1, 3)))[:2] == (0.0, 0.0)


def test_few_products_have_the_whole_spectrum_of_two_cells():
    position = np.array([[0.0, 0.0, 0.0], [9.0, 0.0, 1.0]])
    system = mechanics(np.full(2, 5.0), np.ones(2), duration=60.0)
    decay, residual, growth = spectrum_ends(system, 0.0, position)
    values = np.linalg.eigvals(sparse_jacobian(system).toarray()).real
    assert decay == pytest.approx(-values.min(), rel=1e-10)
    assert growth == pytest.approx(values.max(), abs=1e-10)
    assert residual < 1e-9 * decay


def test_a_motion_out_of_the_plane_does_not_count():
    """A compressed sheet buckles out of its plane faster than anything decays in it."""
    across = np.array([[5.0 * k, 5.0 * j, 0.0] for k in range(6) for j in range(6)])
    system = mechanics(np.full(36, 5.0), np.ones(36), duration=60.0)
    growth = spectrum_ends(system, 0.0, across)[2]
    tilted = across + np.linspace(0.0, 1e-9, 36)[:, None] * np.array([0.0, 0.0, 1.0])
    assert spectrum_ends(system, 0.0, tilted)[2] > growth + 1e-4


def test_what_is_counted_corrects_the_expectation():
    known, constants = Learnt(), costs.constants()
    once = known.counted(2, 200.0, 100.0, implicit=False)
    assert once.excess[2] == pytest.approx(constants["gain"] * math.log(2.0))
    for k in (0, 1, 3, 4):
        assert once.excess[k] == pytest.approx(constants["alike"] * once.excess[2])
    for _ in range(60):
        once = once.counted(2, 200.0, 100.0, implicit=False)
    assert once.excess[2] == pytest.approx(math.log(2.0), rel=1e-3)
    cheap = known.counted(0, 1.0, 1e9, implicit=False)
    assert cheap.excess[0] == pytest.approx(-constants["gain"] * costs._SURE)


def test_a_step_that_was_many_times_as_dear_is_learnt_at_once():
    """By an implicit method, whose solves alone may have jammed, more apart from the others."""
    known = Learnt()
    apart = []
    for method, implicit in ((2, False), (4, True)):
        after = known.counted(method, 750.0, 100.0, implicit=implicit).excess
        assert after[method] == pytest.approx(math.log(7.5))
        apart.append(after[method] - after[0])
    assert 0.3 < apart[0] < apart[1]
    # one that was expected to be half as dear as another is not taken again
    assert math.exp(apart[1]) > 2.0
    jammed = known.counted(4, 1e9, 1.0, implicit=True)
    assert jammed.excess[4] == pytest.approx(costs._SURE)


def test_a_method_that_jams_is_not_taken_again():
    """Where another was expected to cost little more; the run learns it from the count."""
    position, radius, young = cluster(100, 2, spacing=0.9)
    system = mechanics(radius, young, duration=6e5, viscosity=0.05)
    method = Auto(atol=0.1)
    choice = method.by_motion(system, position)
    seen = auto._seen(system, Learnt(), 0.1)
    assert CANDIDATES[choice.method].info.implicit
    found = auto._costs(seen, choice.step, choice.finer, (0.0,) * 5)
    second = sorted(found.values())[1] / found[choice.method]
    assert second < 2.0
    number, expected = NUMBER[choice.method], 100.0
    system.learnt = Learnt().counted(number, 7.5 * expected, expected, implicit=True)
    assert method.by_motion(system, position).method != choice.method


def test_motion_that_was_seen_spares_a_look(monkeypatch):
    """Until a step is dearer than any such motion would make it."""
    position, radius, young = cluster(100, 2, spacing=0.9)
    system = mechanics(radius, young, duration=600.0)
    method, looks = Auto(atol=0.003), []
    speeds = auto._speeds
    monkeypatch.setattr(auto, "_speeds", lambda *args: looks.append(1) or speeds(*args))
    system.learnt = Learnt(speed=3e-5)
    spared = method.choose(system, position)
    assert spared.step is None
    assert not looks
    assert spared.limit < 1e3
    system.learnt = Learnt(speed=3e-5, seen=100.0)
    assert method.choose(system, position).step is not None
    assert len(looks) == 1
    for limit, hold in ((0.0, costs.LOOK), (1e9, spared.hold)):
        system.learnt = Learnt(speed=3e-5)
        monkeypatch.setattr(Auto, "choose", lambda *_, x=limit: replace(spared, limit=x))
        system.begin(replace(system.motion, begin=limit, end=limit + 600.0))
        assert method.integrate(system, position).done
        assert Learnt(*system.learnt).hold == hold
        assert Learnt(*system.learnt).speed == 3e-5
        assert Learnt(*system.learnt).seen == 1.0


def test_a_method_that_was_dearer_than_expected_is_left():
    position, radius, young = cluster(100, 2, spacing=0.9)
    system = mechanics(radius, young, duration=2e4)
    first = Auto(atol=0.1).by_motion(system, position)
    dear = [2.0 * (k == NUMBER[first.method]) for k in range(5)]
    system.learnt = Learnt(*Learnt()[:-5], *dear)
    assert Auto(atol=0.1).by_motion(system, position).method != first.method


def test_the_second_choice_is_tried_when_its_cost_is_a_small_part():
    position, radius, young = cluster(100, 2, spacing=0.9)
    system = mechanics(radius, young, duration=2e4)
    first = Auto(atol=0.1).by_motion(system, position)
    for saved, steps, trial in ((1e9, 7.0, False), (0.0, 8.0, False), (1e9, 8.0, True)):
        system.learnt = Learnt(saved=saved, steps=steps)
        choice = Auto(atol=0.1).by_motion(system, position)
        assert choice.trial == trial
        assert (choice.method != first.method) == trial
    assert Auto(atol=0.1).integrate(system, position).done
    assert Learnt(*system.learnt).steps == Learnt(*system.learnt).saved == 0.0


def test_a_repeated_step_is_left_to_the_method_that_took_it():
    """As from a shifted start; nothing is learnt from it."""
    position, radius, young = cluster(100, 2, spacing=0.9)
    system = mechanics(radius, young, duration=2e4)
    method = Auto(atol=0.1)
    first = method.choose(system, position).method
    assert method.integrate(system, position).done
    learnt, counts = system.learnt, vars(system.work).copy()
    dear = [2.0 * (k == NUMBER[first]) for k in range(5)]
    system.learnt = Learnt(*learnt[:-5], *dear)
    assert method.integrate(system, position + 1e-3).done
    counter = auto.COUNTERS[first]
    assert vars(system.work)[counter] > counts[counter]
    assert system.learnt == Learnt(*learnt[:-5], *dear)


def test_a_measured_rate_is_used_again_as_long_as_it_leaves_no_doubt(monkeypatch):
    position, radius, young = cluster(100, 2, spacing=0.9)
    system = mechanics(radius, young, duration=2e4)
    measured = []
    monkeypatch.setattr(
        auto, "measured_rate", lambda *args: measured.append(1) or measured_rate(*args)
    )
    method, ages = Auto(atol=0.1), []
    for k in range(20):
        system.begin(replace(system.motion, begin=2e4 * k, end=2e4 * (k + 1)))
        assert method.integrate(system, position).done
        ages.append(Learnt(*system.learnt).age)
    assert 1 <= len(measured) < 10
    assert Learnt(*system.learnt).ratio > 0.0
    assert max(ages[:-1]) > 0.0


def test_a_step_without_length_teaches_no_speed(monkeypatch):
    """As where two events fall into one moment; its motion is looked at all the same."""
    position, radius, young = cluster(20, 2, spacing=0.9)
    system = mechanics(radius, young, duration=60.0)
    system.learnt = Learnt(speed=1e-3)
    system.begin(replace(system.motion, end=system.motion.begin))
    monkeypatch.setattr(Auto, "choose", Auto.by_motion)
    outcome = Auto(atol=0.1).integrate(system, position)
    assert outcome.done
    assert outcome.position.tobytes() == position.tobytes()
    assert Learnt(*system.learnt).seen == Learnt(*system.learnt).speed == 0.0


def test_cvode_gets_less_of_the_tolerance_the_stiffer_the_step():
    """At which it is as exact as Rosenbrock's method; what it should cost follows."""
    found = {z: [auto._part(name, 0.5, z) for name in CANDIDATES] for z in (1e3, 1e5, 1e6, 1e9)}
    assert found[1e3] == [1.0, 1.0, 1.0, 0.5, 0.5]
    for z, less in ((1e5, 0.1), (1e6, 0.01), (1e9, 0.01)):
        assert found[z][:-1] == found[1e3][:-1]
        assert found[z][-1] == pytest.approx(0.5 * less)
    _, radius, young = cluster(30, 2, spacing=0.9)
    system = mechanics(radius, young, duration=60.0)
    step = MIDDLE._replace(stiffness=1e6, cells=30)
    expected = auto._costs(auto._seen(system, Learnt(), 0.1), step, 0.5, (0.0,) * 5)
    assert expected["cvode"] == pytest.approx(step.work("cvode", 5e-3) * step.unit("cvode"))
    # and it is given what was expected of it
    method = auto.Choice(1e6, ("cvode",), 0.5)
    solver = Auto(1e-5, 0.1).method("cvode", method.part("cvode"))
    assert (solver.rtol, solver.atol) == pytest.approx((5e-8, 5e-4))


def scene_of(**changes):
    return Scene.from_dict(
        {
            "duration": "4 h",
            "coupling_step": "10 min",
            "initial": {"count": 40, "stage": "uniform"},
            "contact": {"law": "jkr", "surface_energy": 0.1},
            "drag": {"viscosity": 0.3},
            "growth": {"cycle_time": "15 h"},
            **changes,
        }
    )


def run_of(**changes):
    return Simulation(scene_of(**changes), threads=1)


def test_a_run_is_resumed_with_what_it_has_learnt():
    """To the same bits, from every frame; without it, it would choose otherwise."""
    whole = run_of()
    frames = [whole.frame()]
    while not whole.finished:
        whole.step()
        frames.append(whole.frame())
    assert Learnt(*whole.state.learnt).excess != (0.0,) * 5
    assert any(whole.state.work[counter] for counter in auto.COUNTERS.values())
    for k in (3, len(frames) // 2):
        again = Simulation(whole.scene, threads=1, frame=frames[k])
        assert tuple(again.state.learnt) == tuple(frames[k].progress.learnt)
        while not again.finished:
            again.step()
        assert again.cells.position.tobytes() == whole.cells.position.tobytes()
        assert tuple(again.state.learnt) == tuple(whole.state.learnt)
        assert again.state.work == whole.state.work


def test_a_run_that_was_stopped_in_the_middle_is_resumed_with_what_it_has_learnt(tmp_path):
    """From its folder, by other numbers of threads, to the same bits."""
    scene, left = scene_of(output={"every": "30 min"}), iter(range(14))

    def stop(_):
        if next(left, None) is None:
            raise KeyboardInterrupt

    whole = mc.run(scene, output=tmp_path / "whole", threads=1, report=False).frames[-1]
    with pytest.raises(KeyboardInterrupt):
        mc.run(scene, output=tmp_path / "part", threads=2, progress=stop, report=False)
    stopped = mc.load_result(tmp_path / "part").frames[-1]
    assert 0.0 < stopped.time < whole.time
    assert Learnt(*stopped.progress.learnt).excess != (0.0,) * 5
    again = mc.resume(tmp_path / "part", threads=1, report=False).frames[-1]
    assert again.cells.position.tobytes() == whole.cells.position.tobytes()
    assert tuple(again.progress.learnt) == tuple(whole.progress.learnt)


def test_a_scene_that_is_mild_at_a_glance_measures_nothing():
    simulation = run_of(drag={"viscosity": 5.0}, duration="1 h")
    while not simulation.finished:
        simulation.step()
    work = simulation.state.work
    assert work["linearisations"] == work["jacobian_products"] == 0
    assert work["steps"] == work["steps_ab2_adaptive"] > 0


def test_what_is_learnt_is_the_same_for_any_threads():
    """To the bit, in coupling steps with and without a measured λ."""
    position, radius, young = cluster(400, 2, spacing=0.9)
    found = []
    for count in (1, 2, 16):
        system = mechanics(radius, young, duration=60.0, threads=count, chunk=60, shared_chunks=2)
        at, learnt = position, []
        for k in range(3):
            begin = 3e4 * k
            system.begin(replace(system.motion, begin=begin, end=begin + 3e4))
            at = Auto(atol=0.03).integrate(system, at).position
            learnt.append(system.learnt)
        found.append((at.tobytes(), learnt))
    assert Learnt(*found[0][1][-1]).ratio > 0.0
    assert Learnt(*found[0][1][-1]).excess != (0.0,) * 5
    assert found[0] == found[1] == found[2]


def test_an_old_measured_rate_says_no_more_than_none():
    system = mechanics(np.full(20, 5.0), np.ones(20), duration=60.0)
    none = auto._between(system, Learnt())
    known = [auto._between(system, Learnt(ratio=0.8, age=age)) for age in (0.0, 16.0, 1e4)]
    assert known[0][0] == known[0][1]
    for (low, high), (lower, higher) in pairwise(known):
        assert lower < low <= high < higher
    assert known[-1] == pytest.approx(none)
    assert known[1][1] / known[1][0] == pytest.approx(auto._NEAR**4)
    # one that was measured outside of the usual range stays possible
    low, high = auto._between(system, Learnt(ratio=9.0, age=1e4))
    assert low == pytest.approx(none[0])
    assert high == pytest.approx(3.0 * none[1])


@pytest.mark.parametrize("steps", [1e4, 1e6, 1e300])
@pytest.mark.parametrize("known", [{}, {"ratio": 1.0, "speed": 1e-4}])
def test_a_run_may_go_on_for_as_long_as_it_likes(known, steps):
    position, radius, young = cluster(20, 2, spacing=0.9)
    system = mechanics(radius, young, duration=60.0)
    system.learnt = tuple(Learnt(**known, age=steps, seen=steps))
    assert Auto(atol=0.1).integrate(system, position).done
    assert Learnt(*system.learnt).taken == NUMBER["ab2-adaptive"]


def test_a_method_that_gives_up_is_not_learnt_as_cheap(monkeypatch):
    position, radius, young = cluster(100, 2, spacing=0.9)
    system = mechanics(radius, young, duration=60.0)
    system.learnt = tuple(Learnt(hold=costs.LOOK))
    gave_up = []

    def integrate(method, system, position):
        gave_up.append(1)
        return Outcome(system.motion.begin, position.copy(), "gave up")

    monkeypatch.setattr(CANDIDATES["ab2-adaptive"], "integrate", integrate)
    outcome = Auto(atol=0.1).integrate(system, position)
    assert outcome.done
    assert gave_up
    known = Learnt(*system.learnt)
    assert known.excess[NUMBER["ab2-adaptive"]] > 0.3
    assert CANDIDATES["ab2-adaptive"] is not list(CANDIDATES.values())[int(known.taken)]
    # what the first would have been held for is none of the next one's
    assert known.hold == costs.LOOK


def test_a_measured_rate_of_compressed_tissue_counts_for_some_steps():
    """Before and after that, only a measurement gives it; of one cell alone it is nothing."""
    system = mechanics(np.full(20, 5.0), np.ones(20), duration=60.0)
    scale = auto._between(system, Learnt(ratio=1.0))[0]
    system.compression = object()
    assert auto._between(system, Learnt()) == (0.0, 0.0)
    low, high = auto._between(system, Learnt(ratio=9.0, age=4.0))
    assert math.sqrt(low * high) == pytest.approx(9.0 * scale)
    assert high / low == pytest.approx(auto._NEAR)
    assert auto._between(system, Learnt(ratio=9.0, age=auto._OLD)) == (0.0, 0.0)
    alone = mechanics(np.array([5.0]), np.ones(1), duration=60.0)
    assert 0.0 < auto._between(alone, Learnt())[1] < 1e-12


def test_what_is_sure_at_a_glance_is_held_for_some_steps(monkeypatch):
    """Of the same length and tolerance, as long as none is dearer than it could be."""
    position, radius, young = cluster(100, 2, spacing=0.9)
    glances, chosen, moved = [], Auto.choose, Auto.by_motion
    monkeypatch.setattr(Auto, "choose", lambda *args: glances.append(1) or chosen(*args))

    def passed(steps, begin=0.0, length=60.0, atol=0.1, learnt=()):
        system.learnt, at = learnt, position
        del glances[:]
        for k in range(steps):
            start = begin + length * k
            system.begin(replace(system.motion, begin=start, end=start + length))
            at = Auto(atol=atol).integrate(system, at).position
        return Learnt(*system.learnt)

    system = mechanics(radius, young, duration=60.0)
    known = passed(8)
    assert len(glances) == 1
    assert known.hold == 0.0
    assert CANDIDATES["ab2-adaptive"] is list(CANDIDATES.values())[int(known.taken)]
    known = passed(9)
    assert len(glances) == 2
    assert known.hold == auto._HELD
    for change in ({"length": 30.0}, {"atol": 0.3}):
        passed(1, begin=540.0, learnt=tuple(known), **change)
        assert len(glances) == 1
    passed(1, begin=540.0, learnt=tuple(known))
    assert not glances
    dear = passed(1, begin=540.0, learnt=tuple(known._replace(limit=1.0)))
    assert not glances
    assert dear.hold == costs.LOOK
    looks = []
    monkeypatch.setattr(Auto, "by_motion", lambda *args: looks.append(1) or moved(*args))
    assert passed(1, begin=600.0, learnt=tuple(dear)).hold >= 0.0
    assert len(glances) == len(looks) == 1
