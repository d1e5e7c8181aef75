"""The column that tells how fast the most unstable motion of a state grows."""

from __future__ import annotations

import numpy as np
import pytest

import multicell as mc
from multicell.errors import SceneError


def scene(**changes):
    entries = {
        "duration": 21600.0,
        "coupling_step": 1800.0,
        "initial": {"count": 12},
        "growth": {"cycle_time": 14400.0},
        "output": {"every": 7200.0, "instability": True},
    }
    return mc.Scene.from_dict(entries | changes)


def true_rates(simulation):
    """Return the largest and the smallest eigenvalue by differences of the velocities, 1/s."""
    system, x = simulation.prepared(), simulation.cells.position
    time, n, h = simulation.time, x.size, 1e-5
    matrix = np.empty((n, n))
    for k in range(n):
        pair = []
        for sign in (1.0, -1.0):
            moved, out = x.ravel().copy(), np.empty_like(x)
            moved[k] += sign * h
            system.velocity(time, moved.reshape(-1, 3), out)
            pair.append(out.ravel().copy())
        matrix[:, k] = (pair[0] - pair[1]) / (2.0 * h)
    rates = np.linalg.eigvals(matrix).real
    return rates.max(), rates.min()


def test_it_is_the_largest_eigenvalue_of_the_velocities():
    simulation, found, due = mc.Simulation(scene()), [], []
    while not simulation.finished:
        simulation.step()
        found.append(simulation.history_row()["instability_rate"])
        due.append(true_rates(simulation))
    due = np.array(due)
    assert (due[:, 0] > -0.1 * due[:, 1]).sum() >= 3, "no cell has divided"
    # twenty products tell small rates from zero only within a part of the fastest decay
    assert (np.abs(found - due[:, 0]) <= 0.01 * due[:, 0] - 0.02 * due[:, 1]).all()


def test_to_record_it_changes_no_bit_and_a_resumed_run_records_the_same(tmp_path):
    told = mc.run(scene(), output=tmp_path / "a")
    plain = mc.run(scene(output={"every": 7200.0}))
    assert "instability_rate" not in plain.history
    for name, column in plain.history.items():
        np.testing.assert_array_equal(told.history[name], column, err_msg=name)
    np.testing.assert_array_equal(told.frames[-1].cells.position, plain.frames[-1].cells.position)
    work = plain.summary()["integrator"]
    assert told.summary()["integrator"] == work
    mc.run(scene(duration=10800.0), output=tmp_path / "b")
    again = mc.resume(tmp_path / "b", changes={"duration": 21600.0})
    column = told.history["instability_rate"]
    assert np.isfinite(column).all()
    np.testing.assert_array_equal(again.history["instability_rate"], column)


def test_no_rate_with_friction_between_cells():
    with pytest.raises(SceneError, match=r"output\.instability"):
        scene(friction={"normal": 1.0, "tangential": 1.0})
