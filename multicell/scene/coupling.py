"""Lengths of coupling steps: one for all, or bounds between which a run chooses.

With ``coupling_step = "auto"`` steps are an hour halved some times, and end at multiples of their
own length. So their times are exact numbers, and frames land on full hours.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from multicell.errors import SceneError

if TYPE_CHECKING:
    from multicell.scene.scene import Scene


AUTO: Final = "auto"
"""The word in place of a coupling step that lets the run choose."""

USUAL: Final = 600.0
"""The coupling step of a scene that says nothing, s."""

TOLERANCE: Final = 0.005
"""Part of growth that splitting may get wrong where the scene does not say."""

_HOUR: Final = 3600.0
_SHORTEST: Final = _HOUR / 64
_LEAST_STEPS_IN_CYCLE: Final = 12.0
_LEAST_STEPS_IN_REACTION: Final = 2.0


def fixed_step(scene: Scene) -> float | None:
    """Return the length of all coupling steps, s; None where the run chooses it."""
    step = scene.coupling_step
    return None if isinstance(step, str) else step


def usual_step(scene: Scene) -> float:
    """Return the coupling step by which fields are settled or not, s."""
    return fixed_step(scene) or USUAL


def longest_step(scene: Scene) -> float:
    """Return the longest coupling step that a run may take, s."""
    fixed = fixed_step(scene)
    if fixed is not None:
        return fixed
    limit = min(
        _HOUR,
        quickest_cycle(scene) / _LEAST_STEPS_IN_CYCLE,
        scene.cells.reaction_time / _LEAST_STEPS_IN_REACTION,
    )
    step = _HOUR
    while step > limit:
        step *= 0.5
    return step


def shortest_step(scene: Scene) -> float:
    """Return the shortest coupling step that a run may choose, s."""
    return fixed_step(scene) or min(_SHORTEST, longest_step(scene))


def tolerance(scene: Scene) -> float:
    """Return the part of growth that splitting may get wrong in a scene that chooses its steps."""
    return TOLERANCE if scene.coupling_tolerance is None else scene.coupling_tolerance


def quickest_cycle(scene: Scene) -> float:
    """Return the mean cycle of the quickest type of cells, s."""
    assert scene.growth is not None
    quickest = min((kind.cycle_scale for kind in scene.types.values()), default=1.0)
    return quickest * scene.growth.mean_cycle


def check_coupling(scene: Scene) -> None:
    """Raise ``SceneError`` for a choice of steps that has no effect, or is blind for the scene."""
    if fixed_step(scene) is not None:
        if scene.coupling_tolerance is not None:
            hint = 'coupling_step = "auto" lets the run choose its steps by this tolerance.'
            raise SceneError("coupling_tolerance", "has no effect: coupling_step is fixed", hint)
        return
    if scene.growth is None:
        hint = 'Give a time, for example coupling_step = "10 min".'
        problem = "is 'auto', but the scene has no growth, which limits the steps"
        raise SceneError("coupling_step", problem, hint)
    frozen = {
        "contact": scene.contact.remembers,
        "motility": scene.motility is not None,
        "chemotaxis": bool(scene.chemotaxis),
        "haptotaxis": scene.haptotaxis is not None,
        "pull": scene.pull is not None,
        "surface": scene.surface is not None,
        "death": scene.death is not None and scene.death.inflow,
    }
    for name, present in frozen.items():
        if present:
            what = "which pairs touch is" if name == "contact" else f"forces of [{name}] are"
            problem = f"is 'auto', but {what} held fixed in a step, which its estimate does not see"
            hint = f'Give a time that is short for [{name}], for example coupling_step = "1 min".'
            raise SceneError("coupling_step", problem, hint)
