"""Recording a scene, whole or in samples, and replaying it by other methods."""

from dataclasses import dataclass

import numpy as np
import pytest
from synthetic import cells_at
from two_cells import GROWING

from multicell import Simulation
from multicell.comparison.record import StepRecorder, compose_events, events_between, record
from multicell.comparison.replay import RecordedEvents, replay
from multicell.comparison.work_precision import compare
from multicell.errors import SceneError
from multicell.integrators.base import Outcome
from multicell.integrators.runge_kutta import Euler

# the whole run


@dataclass(frozen=True)
class Spy:
    """Euler's method that notes what it is given."""

    inner: Euler
    seen: list

    def integrate(self, system, position):
        motion = system.motion
        ends = motion.radius + motion.radius_rate * (motion.end - motion.begin)
        self.seen.append((motion.begin, motion.end, motion.radius, ends, motion.young))
        return self.inner.integrate(system, position)


@pytest.fixture(scope="module")
def grown():
    return record(GROWING, Euler(5.0))


def test_the_record_is_the_simulation(grown):
    problem, trajectory = grown
    simulation = Simulation(GROWING.with_changes({"integrator": "euler", "integrator.step": 5.0}))
    while not simulation.finished:
        before = simulation.cells
        simulation.step()
        k = simulation.step_index - 1
        np.testing.assert_array_equal(before.radius, problem.steps[k].motion.radius)
        if k + 1 < len(problem.steps):
            after = problem.steps[k + 1].before
            ends = trajectory.positions[k]
            ends = ends if after is None else after.apply(ends)
            np.testing.assert_allclose(simulation.cells.position, ends, atol=1e-12)
    assert simulation.divisions >= 5
    assert len(problem.steps) == simulation.steps == 36
    assert problem.times[-1] == GROWING.duration


def test_a_replay_by_the_recording_method_retraces_it_to_rounding(grown):
    problem, trajectory = grown
    again = replay(problem, Euler(5.0))
    assert again.done
    assert again.work == trajectory.work
    for a, b in zip(again.positions, trajectory.positions, strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-11)


def test_all_methods_get_the_same_cells_events_and_times(grown):
    problem, _ = grown
    coarse, fine = Spy(Euler(30.0), []), Spy(Euler(2.0), [])
    ends = [replay(problem, spy) for spy in (coarse, fine)]
    assert all(end.done for end in ends)
    assert len(coarse.seen) == len(fine.seen) == 36
    for a, b in zip(coarse.seen, fine.seen, strict=True):
        for x, y in zip(a, b, strict=True):
            np.testing.assert_array_equal(x, y)
    counts = [[len(p) for p in end.positions] for end in ends]
    assert counts[0] == counts[1] == problem.counts.tolist()
    assert counts[0][-1] > counts[0][0] == 12
    assert np.abs(ends[0].positions[-1] - ends[1].positions[-1]).max() > 1e-6


def test_a_daughter_is_laid_beside_her_mother_wherever_a_method_has_led_her(grown):
    problem, trajectory = grown
    k, events = next((k, s.before) for k, s in enumerate(problem.steps) if s.before is not None)
    moved = trajectory.positions[k - 1] + [3.0, -2.0, 1.0]
    radius = problem.steps[k - 1].motion
    mother = radius.radius + radius.radius_rate * (radius.end - radius.begin)
    after = events.apply(moved)
    daughters = np.flatnonzero(np.linalg.norm(events.offset, axis=1) > 0)
    assert len(daughters) % 2 == 0
    distance = np.linalg.norm(after - moved[events.source], axis=1)
    expected = mother[events.source[daughters]] * (1 - 0.5 ** (1 / 3))
    np.testing.assert_allclose(distance[daughters], expected, rtol=1e-9)
    others = np.setdiff1d(np.arange(len(after)), daughters)
    np.testing.assert_array_equal(distance[others], 0.0)


def test_division_removal_and_a_new_order_at_once():
    before = cells_at(np.arange(12.0).reshape(4, 3))
    before.id[:] = [7, 3, 9, 5]
    after = cells_at(np.zeros((4, 3)))
    after.id[:] = [11, 9, 10, 7]  # 3 divided into 10 and 11, 5 is gone
    after.parent[:] = [3, -1, 3, -1]
    after.position[:] = before.position[[1, 2, 1, 0]]
    after.position[0] += [0.0, 1.5, 0.0]
    after.position[2] -= [0.0, 1.5, 0.0]
    events = events_between(before, before.position, after)
    np.testing.assert_array_equal(events.source, [1, 2, 1, 0])
    np.testing.assert_array_equal(events.offset[:, 1], [1.5, 0.0, -1.5, 0.0])
    np.testing.assert_array_equal(events.apply(before.position), after.position)
    assert events_between(before, before.position, before) is None


# few cells: steps in which one is alone are no steps that a method solves

MORTAL = GROWING.with_changes(
    {
        "initial.count": 1, "initial.stage": "birth", "duration": "14 h",
        "growth.cycle_time": "2 h", "stop_cells": 12,
        "death": {
            "apoptosis_rate": "1e-4 1/s", "apoptosis_time": "20 min", "removal_fraction": 0.5
        },
    }
)  # fmt: skip


@pytest.mark.parametrize(
    ("seed", "counts"),
    [
        (7, [1, 2, 0]),
        (13, [1, 2, 1, 2, 1, 2, 1, 2, 1, 2, 1, 0]),
        (12, [1, 2, 4, 3, 1, 2, 1, 0]),
        (52, [1, 2, 1, 2, 1, 2, 4, 3, 4, 5, 4, 3, 2, 3]),
    ],
)
def test_a_replay_meets_the_run_however_few_cells_are_left(seed, counts):
    scene = MORTAL.with_changes({"seed": seed})
    problem, _ = record(scene, Euler(5.0))
    again = replay(problem, Euler(5.0))
    simulation = Simulation(scene, integrator=Euler(5.0))
    seen, begins = [1], []
    while not simulation.finished and len(simulation.cells):
        if len(simulation.cells) > 1:
            begins.append(simulation.cells.position)
        simulation.step()
        if len(simulation.cells) != seen[-1]:
            seen.append(len(simulation.cells))
    assert seen == counts  # the scene is the case that it stands for
    assert again.done
    assert len(begins) == len(problem.steps)
    for k, begin in enumerate(begins):
        reached = problem.start if k == 0 else again.positions[k - 1]
        np.testing.assert_allclose(problem.beginning(k, reached), begin, rtol=0, atol=1e-11)
    np.testing.assert_array_equal(problem.start, begins[0])


def test_events_of_steps_that_are_left_out_are_carried_on():
    """A mother divides, one daughter dies, and the other divides before any cell moves again."""
    east, west = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])
    divided = RecordedEvents(np.array([0, 0, 1]), np.array([east, west, 0 * east]))
    died = RecordedEvents(np.array([1]), np.zeros((1, 3)))
    again = RecordedEvents(np.array([0, 0]), np.array([2 * east, 2 * west]))
    position = np.array([[10.0, 0.0, 0.0], [50.0, 0.0, 0.0]])
    whole = compose_events(compose_events(divided, died), again)
    np.testing.assert_array_equal(whole.apply(position), [[11.0, 0.0, 0.0], [7.0, 0.0, 0.0]])
    assert compose_events(None, died) is compose_events(died, None) is died


@pytest.mark.parametrize("stepwise", [False, 3])
def test_a_comparison_begins_where_the_only_cell_has_divided(stepwise):
    scene = MORTAL.with_changes({"duration": "3 h", "death": None})
    exact = [("euler", 10.0), ("euler", 20.0)]
    found = compare(scene, ["euler"], {"step": [60.0]}, stepwise=stepwise, references=exact)
    assert found.table[0]["status"] == "done"
    assert 0.0 < found.table[0]["error_position"] < 1.0
    assert found.facts["cells"][0] == 2


@pytest.mark.parametrize("stepwise", [False, 3])
def test_one_cell_on_which_nothing_acts_is_refused_in_words(stepwise):
    alone = {"initial.count": 1, "growth": None, "duration": "2 h"}
    with pytest.raises(SceneError, match="initial: leaves nothing to compare"):
        compare(GROWING.with_changes(alone), ["euler"], stepwise=stepwise)


def test_one_cell_on_which_something_acts_is_compared():
    crawls = {"initial.count": 1, "growth": None, "duration": "1 h",
              "motility": {"force": "0.1 nN", "persistence": "10 min"}}  # fmt: skip
    result = compare(GROWING.with_changes(crawls), ["euler"], {"step": [60.0]})
    assert result.table[0]["status"] == "done"


# a sample of its steps


def noted(total, count):
    """Return the steps that a sampler keeps of a run of ``total`` steps, by the first
    coordinate."""

    class Stays:
        def integrate(self, system, position):
            return Outcome(0.0, position)

    class System:
        motion = None

        def at_end(self, position):
            return position

    sampler = StepRecorder(Stays(), count)
    stored = 0
    for k in range(total):
        sampler.integrate(System(), np.full((1, 3), float(k)))
        stored = max(stored, len(sampler.steps))
    return [int(state.start[0, 0]) for state in sampler.select()], stored


@pytest.mark.parametrize(("total", "count"), [(1, 4), (7, 24), (24, 24), (25, 24), (97, 5)])
def test_a_sample_is_taken_from_the_middles_of_equal_parts(total, count):
    chosen, _ = noted(total, count)
    parts = min(total, count)
    assert len(set(chosen)) == parts
    edges = np.linspace(0, total, parts + 1)
    middles = 0.5 * (edges[1:] + edges[:-1]) - 0.5
    np.testing.assert_allclose(chosen, middles, atol=0.5 if total <= 16 * count else 1.0)


def test_a_long_run_is_sampled_with_few_states_held():
    chosen, stored = noted(5000, 6)
    assert stored <= 16 * 6 + 1
    # states are stored at a stride of at most an eighth of the distance between two samples
    middles = (np.arange(6) + 0.5) * 5000 / 6
    np.testing.assert_allclose(chosen, middles, atol=5000 / 6 / 16 + 1)


def test_the_sampled_states_are_those_of_the_simulation():
    problem, _ = record(GROWING, Euler(5.0), 7)
    simulation = Simulation(GROWING.with_changes({"integrator": "euler", "integrator.step": 5.0}))
    begins = {step.motion.begin: k for k, step in enumerate(problem.steps)}
    seen = 0
    while not simulation.finished:
        k = begins.get(simulation.time)
        if k is not None:
            np.testing.assert_array_equal(problem.starts[k], simulation.cells.position)
            np.testing.assert_array_equal(problem.steps[k].motion.radius, simulation.cells.radius)
            seen += 1
        simulation.step()
    assert seen == 7
    assert problem.total == simulation.steps == 36
    assert problem.counts[-1] > problem.counts[0] >= 12
