"""Promises of observables."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from multicell.cells import IntArray, State
from multicell.errors import SceneError
from multicell.results.observable import Observable, TissueState
from multicell.testing.promises import fail_with

if TYPE_CHECKING:
    from multicell.results.frame import Frame
    from multicell.scene.scene import Scene

OBSERVED: Mapping[str, Any] = {
    "duration": "1 h",
    "coupling_step": "10 min",
    "initial": {"count": 30, "stage": "asynchronous"},
    "growth": {"critical_pressure": 0.1},
    "death": {},
    "types": {"soft": {"young": 0.5}, "stiff": {"young": 2.0}},
    "nutrients": {"oxygen": {"boundary": 0.07, "quiescence": 0.06, "necrosis": 0.01}},
}
"""The scene of :func:`check_observable` where none is given."""
BARE: Mapping[str, Any] = {
    "duration": "1 h",
    "coupling_step": "10 min",
    "initial": {"count": 9},
}
"""A scene without any optional part."""


def check_observable(observable: Observable, scene: Scene | None = None) -> None:
    """Check an observable; raise ``AssertionError`` with every requirement that it violates.

    In a scene at its start and after two coupling steps, with a single cell, without cells and
    with dead cells only, and in a scene without any optional part unless it ``needs`` one:

    - it is one finite number, or NaN if it states when it is ``absent``;
    - it is not negative unless it is ``signed``;
    - it is the same if asked twice, and if the cells have another order;
    - it writes into no array of the state.

    Parameters
    ----------
    observable
        Made by :func:`multicell.observable`.
    scene
        One that has what it needs; by default a small one with two types and oxygen.
    """
    from multicell.scene.scene import Scene

    bare = Scene.from_dict(BARE)
    tried = 0
    problems: list[str] = []
    for place, one in (("", scene or Scene.from_dict(OBSERVED)), (" in a bare scene", bare)):
        try:
            keys = observable.keys(one)
        except SceneError as error:
            problems += [] if one is bare else [f"{error}: give check_observable a scene with it"]
            continue
        for case, frame in _frames(one):
            for key in keys:
                tried += 1
                found = _observed(observable, TissueState(frame, one), key)
                problems += [f"{case}{place} it {problem}" for problem in found]
    if not (tried or problems):
        problems = ["it does not exist in the scene: give check_observable one that has it"]
    fail_with(observable.name, problems)


class ObservableTests:
    """Tests of an observable; a subclass gives it by a fixture of pytest.

    ::

        class TestRim(ObservableTests):
            @pytest.fixture
            def observable(self):
                return rim_ratio
    """

    scene: ClassVar[Scene | None] = None
    """One that has what the observable needs; by default a small one with two types and oxygen."""

    def test_observable_keeps_its_promises(self, observable: Observable) -> None:
        """All of :func:`check_observable`."""
        check_observable(observable, self.scene)

    def test_unit_and_words_are_stated(self, observable: Observable) -> None:
        """Tables and charts have a unit, and words for the axis."""
        problems = [
            f"states no {name}" for name in ("name", "title") if not getattr(observable, name)
        ]
        fail_with(observable.name, [f"it {problem}" for problem in problems])


def _frames(scene: Scene) -> Iterator[tuple[str, Frame]]:
    from multicell.simulation import Simulation

    simulation = Simulation(scene, threads=1)
    yield "at the start", simulation.frame()
    for _ in range(2):
        simulation.step()
    frame = simulation.frame()
    yield "after two steps", frame
    yield "with a single cell", _taken(frame, np.arange(1))
    yield "without cells", _taken(frame, np.arange(0))
    dead = frame.cells.copy()
    dead.state[:] = State.NECROTIC
    yield "with dead cells only", replace(frame, cells=dead)


def _taken(frame: Frame, index: IntArray) -> Frame:
    """Return a frame with some of its cells, in another order."""
    known = {name: values[index] for name, values in frame.concentrations.items()}
    return replace(frame, cells=frame.cells.take(index), concentrations=known)


def _observed(observable: Observable, state: TissueState, key: str) -> Iterator[str]:
    """Yield the faults of an observable in a state."""
    order = np.random.default_rng(7).permutation(len(state.cells))
    turned = TissueState(_taken(state.frame, order), state.scene)
    states = (state, state, turned)
    try:
        value, again, other = (float(observable.value(s.sealed, key)) for s in states)
    except Exception as error:
        yield f"fails: {error}"
        return
    if not math.isfinite(value) and not (math.isnan(value) and observable.absent):
        yield f"is {value}, and does not state when it is absent"
    if value < 0.0 and not observable.signed:
        yield f"is {value:g}, which is negative, and is not signed"
    if not np.array_equal(value, again, equal_nan=True):
        yield f"is {value!r}, and {again!r} if asked again"
    if not np.isclose(value, other, rtol=1e-9, atol=0.0, equal_nan=True):
        yield f"is {value!r}, and {other!r} with the cells in another order"
