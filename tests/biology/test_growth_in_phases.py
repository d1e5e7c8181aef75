"""Growth at a rate of its own in phases with targets of their own, and the part of Ki67+ cells."""

import numpy as np
import pytest
from running import refused
from scipy.integrate import solve_ivp

from multicell.biology.cycle import advance_cycle
from multicell.biology.draws import draw_lengths
from multicell.biology.initial import initial_cells
from multicell.biology.plan import biology_plan
from multicell.cells import Phase, State
from multicell.errors import DataError
from multicell.scene.scene import Scene
from multicell.simulation import Simulation

HOUR = 3600.0
GAMMA = {"distribution": "gamma", "variation": 0.5}
TARGET, DOUBLING = 1.25, 12.0 * HOUR
RATE = np.log((2 * TARGET - 1) / (2 * TARGET - 2)) / DOUBLING
SCALES = {"G1": 0.5, "S": 1.0, "G2": 0.9, "M": 1.0}


def scene(**growth):
    phases = {
        name: {"duration": hours * HOUR, **GAMMA, "target_scale": SCALES[name]}
        for name, hours in zip(("G1", "S", "G2", "M"), (9, 7, 4, 2), strict=True)
    }
    given = {
        "phases": phases, "law": "relaxation", "parameters": {"target": TARGET},
        "volume_doubling_time": DOUBLING, "restriction": False, **growth,
    }  # fmt: skip
    return Scene.from_dict({
        "duration": "1 d", "coupling_step": "5 min", "contact": {"law": "hertz"},
        "initial": {"count": 40, "stage": "uniform"}, "growth": given,
    })  # fmt: skip


def relaxed(volume, times, names):
    """Return a volume over that at birth after times in phases, by SciPy: V' = r (K - V)."""
    for name, time in zip(names, times, strict=True):
        largest = 2.0 * TARGET * SCALES[name]
        found = solve_ivp(
            lambda t, v, k=largest: RATE * (k - v), (0, time), [volume], rtol=1e-10, atol=1e-12
        )
        volume = found.y[0, -1]
    return volume


def test_volumes_at_the_start_are_those_of_the_phases_that_are_behind_cells():
    described = scene()
    plan, cells = biology_plan(described), initial_cells(described)
    assert len(set(cells.phase.tolist())) == 4
    np.testing.assert_allclose(cells.cycle_time, DOUBLING)
    lengths = draw_lengths(plan, cells.id, cells.kind)
    for row in range(len(cells)):
        place = int(cells.phase[row])
        times = [*lengths[row, : place - 1], cells.progress[row]]
        expected = relaxed(1.0, times, list(SCALES)[:place])
        assert cells.volume[row] / plan.birth_volume == pytest.approx(expected, rel=1e-8)


def test_growth_over_the_end_of_a_phase_goes_to_the_next_target():
    described = scene()
    plan, cells = biology_plan(described), initial_cells(described)
    dt = 3.0 * HOUR
    ends = cells.phase_length - cells.progress
    now = advance_cycle(plan, cells, np.ones(40), np.zeros(40, bool), dt)
    crosses = np.flatnonzero((ends < dt) & (now.phase == cells.phase + 1))
    assert crosses.size > 5
    for row in crosses:
        names = list(SCALES)[cells.phase[row] - 1 : now.phase[row]]
        start = cells.volume[row] / plan.birth_volume
        expected = relaxed(start, [ends[row], dt - ends[row]], names)
        assert now.volume[row] / plan.birth_volume == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize(
    ("growth", "path", "words"),
    [
        ({"law": "exponential", "parameters": {}}, "growth.volume_doubling_time", "wander"),
        ({"law": "linear", "parameters": {}}, "growth.phases.G1.target_scale", "relaxation"),
        ({"phases": {}}, "growth.volume_doubling_time", "needs phases"),
        ({"phases": {}, "volume_doubling_time": None, "ki67_decay": 5.0}, "growth.ki67_decay",
         "needs phases"),
    ],
)  # fmt: skip
def test_keys_that_cannot_be(growth, path, words):
    with refused(path, words):
        scene(**growth)


def test_a_type_has_a_rate_only_where_the_scene_has_one():
    described = scene().with_changes({"types": {"a": {}, "b": {"volume_doubling_time": "6 h"}}})
    cells = initial_cells(described)
    assert set(cells.cycle_time[cells.kind == 1]) == {6 * HOUR}
    assert set(cells.cycle_time[cells.kind == 0]) == {DOUBLING}
    with refused("types.b.volume_doubling_time", "needs growth.volume_doubling_time"):
        described.with_changes({"growth.volume_doubling_time": None})


def test_sizes_without_phases_are_refused_where_they_tell_no_phase(tmp_path):
    table = tmp_path / "cells.csv"
    table.write_text("position_x_um,position_y_um,position_z_um,radius_um\n0,0,0,4.2\n")
    with pytest.raises(DataError, match="has no column 'phase'"):
        Simulation(scene().with_changes({"initial.cells": str(table)}))


def test_the_ki67_positive_part_is_counted_by_phase_and_time_since_division():
    described = scene(ki67_decay="2 h").with_changes(
        {"types": {"a": {}, "slow": {"cycle_scale": 2.0}}}
    )
    run = Simulation(described, threads=1)
    cells = run.cells
    cells.phase[:] = np.repeat([Phase.G1, Phase.S, Phase.G2, Phase.M], 10)
    cells.kind[:] = 0
    cells.kind[:5] = 1
    cells.progress[:10] = np.array([1, 3, 3.9, 4.1, 5, 0, 1.9, 2.1, 3, 4]) * HOUR
    assert run.history_row()["ki67_positive"] == pytest.approx((3 + 2 + 30) / 40)
    cells.state[20:] = State.NECROTIC
    assert run.history_row()["ki67_positive"] == pytest.approx((3 + 2 + 10) / 20)
    assert "ki67_positive" not in Simulation(scene(), threads=1).history_row()
