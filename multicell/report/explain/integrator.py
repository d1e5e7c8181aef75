"""What the method ``auto`` would choose, and why."""

from __future__ import annotations

from typing import TYPE_CHECKING

from multicell.integrators.auto import MILD, Auto, choose

if TYPE_CHECKING:
    from multicell.scene.scene import Scene


def explain_choice(scene: Scene) -> str:
    """Return, for a person, what is chosen for the first coupling step of a scene, and why.

    The cells are put in place and what they feel is computed; the coupling step is tried as far
    as the choice needs it.
    """
    from multicell.simulation import Simulation

    options = scene.integrator
    auto = Auto(options.rtol, options.tolerance, options.max_steps, options.max_displacement)
    start = Simulation(scene, threads=1)
    system, position = start.prepared(), start.cells.position
    _, choice = auto.begin(system, position)
    evaluations = system.work.evaluations
    where = f"in the first coupling step, with {len(position):,} cell(s),"
    if choice is None:
        rate = choose(system, position, options.rtol, options.tolerance).rate
        stiffness = rate * (system.motion.end - system.motion.begin)
        return (
            f"{where} {MILD}, since it needs {evaluations} evaluations, too few for anything else "
            f"to be tried; stiffness λΔt is {stiffness:.3g} (λ = {rate:.3g}/s)"
        )
    return f"{where} {choice.method}: {choice.reason}"
