"""One function decides on growth: additions there act on volume, lag and cycle alike."""

import importlib
import pkgutil

import numpy as np
import pytest
from running import finished

import multicell as mc
from multicell import biology
from multicell.biology import growth
from multicell.cells import SPHERE, Phase
from multicell.scene.sizes import birth_volume
from multicell.simulation import Simulation

HOUR = 3600.0
CYCLE = 9.0
HOURS = {"G1": 4.0, "S": 3.0, "G2": 1.5, "M": 0.5}
CYCLES = {
    "without phases": {"cycle_time": CYCLE * HOUR, "cycle_variation": 0.0},
    "with phases": {"phases": {name: {"duration": h * HOUR} for name, h in HOURS.items()}},
    "with a resting G1": {"phases": {name: {"duration": h * HOUR, "grows": name != "G1"}
                                     for name, h in HOURS.items()}},
}  # fmt: skip


def scene(cycle, hours, law="linear"):
    return mc.Scene.from_dict({
        "duration": hours * HOUR, "coupling_step": "10 min", "contact": {"law": "hertz"},
        "initial": {"count": 4, "stage": "birth", "spacing": 2.0},
        "growth": {"law": law, **CYCLES[cycle]},
    })  # fmt: skip


def decide_by(monkeypatch, also):
    """Let cells grow only where ``also(cells)`` says so, as a key of the scene would."""
    own, found = growth.growing, 0

    def growing(plan, cells, phase=None):
        return own(plan, cells, phase) & also(cells)

    for info in pkgutil.iter_modules(biology.__path__, f"{biology.__name__}."):
        module = importlib.import_module(info.name)
        if getattr(module, "growing", None) is own:
            monkeypatch.setattr(module, "growing", growing)
            found += 1
    assert found > 1


@pytest.mark.parametrize("law", ["linear", "exponential"])
@pytest.mark.parametrize("cycle", ["without phases", "with phases"])
def test_cells_that_wait_after_birth_are_as_late_as_they_wait(cycle, law, monkeypatch):
    wait = 2.0
    decide_by(monkeypatch, lambda cells: cells.age >= wait * HOUR)
    described = scene(cycle, 5.0, law)
    share = (5.0 - wait) / CYCLE
    expected = 1.0 + share if law == "linear" else 2.0**share
    ratio = finished(described).cells.volume / birth_volume(described)
    np.testing.assert_allclose(ratio, expected, rtol=1e-12)
    # they divide after 11 h, and their daughters wait as well
    described = scene(cycle, 14.0, law)
    cells = finished(described).cells
    assert len(cells) == 8
    share = (14.0 - wait - CYCLE - wait) / CYCLE
    expected = 1.0 + share if law == "linear" else 2.0**share
    ratio = cells.volume / birth_volume(described)
    np.testing.assert_allclose(ratio, expected, atol=1.01 / (6.0 * CYCLE))


@pytest.mark.parametrize("cycle", CYCLES)
def test_cells_that_may_not_grow_do_nothing_of_it(cycle, monkeypatch):
    decide_by(monkeypatch, lambda cells: np.zeros(len(cells), dtype=bool))
    described = scene(cycle, 30.0)
    run = Simulation(described, threads=1)
    run.cells.lag = np.full(len(run.cells), 600.0)
    cells = finished(run).cells
    assert len(cells) == 4
    np.testing.assert_array_equal(cells.lag, 600.0)
    np.testing.assert_allclose(SPHERE * cells.radius**3, birth_volume(described), rtol=1e-12)
    # the clock goes on where it does not follow growth, and stands where it does
    phase = {"without phases": Phase.G0, "with phases": Phase.G1, "with a resting G1": Phase.S}
    assert set(cells.phase.tolist()) == {phase[cycle]}
    assert not cells.progress.any()
