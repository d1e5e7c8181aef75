"""What another process does on a few cells has the types of what the run does later on."""

import numpy as np
import pytest

import multicell as mc
from multicell import rehearsed
from multicell.compiling import kind_of
from multicell.integrators import driver, stepping
from multicell.integrators.auto import CANDIDATES, MILD
from multicell.integrators.base import Outcome
from multicell.nutrient import multigrid, steady
from multicell.simulation import Simulation

PHASES = {
    "G1": {"duration": "1 h"},
    "S": {"duration": "1 h"},
    "G2": {"duration": "1 h"},
    "M": {"duration": "2 h", "grows": False},
}
CASES = {
    "a field": ("spheroid", {"initial.count": 3}),
    "nothing but growth": ("growth", {"initial.count": 3}),
    "receptors": ("sorting-cams", {"initial.count": 20}),
    "external forces": ("chemotaxis", {"initial.count": 3}),
    "daughters that part": (
        "growth",
        {
            "initial.count": 3,
            "growth": {"division": "smooth", "phases": PHASES},
        },
    ),
}


def lent(system, monkeypatch):
    """Return the types of what a loop is given."""
    monkeypatch.setattr(stepping, "addressed", lambda source, pairs, **_: source)
    source, pairs = driver._borrow(system, np.zeros(4, dtype=np.int64))
    return kind_of((source, pairs, system.motion.radius))


@pytest.mark.parametrize("case", CASES)
def test_two_cells_are_given_to_a_loop_as_those_of_the_run_are(case, monkeypatch):
    name, changes = CASES[case]
    scene = mc.load_scene(name).with_changes(changes)
    system, position = rehearsed.touching(scene, 2)
    run = Simulation(scene, threads=1)
    assert lent(system, monkeypatch) == lent(run.prepared(), monkeypatch)
    assert kind_of(position) == kind_of(run.cells.position)


@pytest.mark.parametrize("count", [2, 27])
def test_the_cells_touch_and_none_lies_on_another(count):
    scene = mc.load_scene("growth")
    system, position = rehearsed.touching(scene, count)
    contacts = system.contacts(0.0, position)
    assert set(contacts.ravel()) == set(range(count))
    away = position[contacts[:, 0]] - position[contacts[:, 1]]
    assert np.linalg.norm(away, axis=1).min() > system.motion.radius.max()


@pytest.mark.parametrize(
    ("changes", "left_out"),
    [({}, set()), ({"friction": {"normal": 1.0, "tangential": 1.0}}, {"rosenbrock"})],
    ids=["free", "friction"],
)
def test_every_method_that_may_be_chosen_has_its_turn(changes, left_out, monkeypatch):
    done = []

    def integrate(method, system, position):
        done.append(method.info.name)
        return Outcome(system.motion.end, position)

    for kind in CANDIDATES.values():
        monkeypatch.setattr(kind, "integrate", integrate)
    monkeypatch.setattr(rehearsed, "choose", lambda *given: done.append("choice"))
    scene = mc.load_scene("growth").with_changes(changes)
    rehearsed.other_methods(scene)
    assert done[0] == "choice"
    assert set(done[1:]) == set(CANDIDATES) - {MILD} - left_out
    assert done[-1] == rehearsed.LAST


def test_two_cells_go_through_all_of_a_step_by_the_method_of_the_run(monkeypatch):
    done = []

    def integrate(method, system, position):
        done.append(method.info.name)
        return Outcome(system.motion.end, position)

    for kind in CANDIDATES.values():
        monkeypatch.setattr(kind, "integrate", integrate)
    for name in ("auto", "cvode", "dopri5"):
        rehearsed.first_contact(mc.load_scene("growth").with_changes({"integrator": name}))
    assert done == [MILD, "cvode", "dopri5"]


def test_fields_are_solved_for_by_multigrid(monkeypatch):
    class ReachedError(Exception):
        pass

    def reached(*given):
        raise ReachedError

    monkeypatch.setattr(steady, "MANY", steady.MANY)
    monkeypatch.setattr(multigrid, "MultigridSolver", reached)
    with pytest.raises(ReachedError):
        rehearsed.many_nodes(mc.load_scene("spheroid"))
