"""Conditions that start phases of the cycle, and divisions: a signal that passes a value."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, final

from multicell.behaviours.catalogue import OF_NEIGHBOURS, PHASE
from multicell.cells import Phase
from multicell.errors import SceneError
from multicell.scene.networks import check_kinds_have
from multicell.scene.parts import CYCLE_PHASES
from multicell.scene.responses import check_signal, signal_reader

if TYPE_CHECKING:
    from multicell.scene.scene import Scene

_HINT = "Write for example 'cycle.MPF > 0.1'."


@final
@dataclass(frozen=True)
class PhaseCondition:
    """A condition that ends a phase of the cycle: a signal above a level, or below it.

    - ``ends``: the phase
    - ``level``: in the base unit of the signal, or in the unit of its network
    - ``network``, ``name``: of a value of a network in the cell itself; empty for other signals
    """

    ends: Phase
    signal: str
    rises: bool
    level: float
    network: str = ""
    name: str = ""


def conditions(scene: Scene) -> tuple[PhaseCondition, ...]:
    """Return the conditions of a scene.

    Raises SceneError for what is none, a signal that the scene does not have, and a response of the
    entry into a phase that begins by a condition.
    """
    if scene.growth is None:
        return ()
    phases = scene.growth.phases.items()
    return tuple(_condition(scene, name) for name, part in phases if part.after is not None)


def _condition(scene: Scene, phase: str) -> PhaseCondition:
    assert scene.growth is not None
    path, text = f"growth.phases.{phase}.after", scene.growth.phases[phase].after or ""
    sign = ">" if ">" in text else "<"
    signal, passes, value = (word.strip() for word in text.partition(sign))
    if not (signal and passes and value):
        problem = f"is {text!r}, must be 'SIGNAL > VALUE' or 'SIGNAL < VALUE'"
        raise SceneError(path, problem, _HINT)
    check_signal(scene, signal, path)
    check_kinds_have(scene, signal, (), path)
    if signal.startswith(PHASE):
        problem = f"names {signal!r}, which the cycle itself sets"
        raise SceneError(path, problem, "Without the key the phase begins after the one before.")
    for name, part in scene.responses.items():
        if part.behaviour == f"entry into {phase}":
            problem = f"leaves no effect to responses.{name}: it starts the phase alone"
            raise SceneError(path, problem, "Leave one of the two out.")
    given: float | str = value
    with suppress(ValueError):  # it may have a unit
        given = float(value)
    level = signal_reader(scene, signal)(given, path)
    network, _, name = signal.partition(".")
    own = bool(name) and OF_NEIGHBOURS not in signal
    ends = Phase[CYCLE_PHASES[CYCLE_PHASES.index(phase) - 1]]
    return PhaseCondition(ends, signal, sign == ">", level, *((network, name) if own else ()))
