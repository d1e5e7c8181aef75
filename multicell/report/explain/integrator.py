"""What the method ``auto`` would choose, and why."""

from __future__ import annotations

from typing import TYPE_CHECKING

from multicell.integrators.auto import MILD, PATIENCE, Auto, choose

if TYPE_CHECKING:
    from multicell.scene.scene import Scene


def explained(scene: Scene) -> str:
    """Return, for a person, what is chosen for the first coupling step of a scene, and why.

    The cells are put in place and what they feel is computed; the coupling step is tried as far
    as the choice needs it.
    """
    from multicell.simulation import Simulation

    options = scene.integrator
    auto = Auto(options.rtol, options.atol, options.max_steps, options.max_displacement)
    start = Simulation(scene, threads=1)
    system, position = start.prepared(), start.cells.position
    outcome, expected = auto.try_mild(system, position)
    evaluations = system.work.evaluations
    found = choose(system, position, options.rtol, options.atol, expected)
    where = f"in the first coupling step, with {len(position):,} cell(s),"
    if outcome.done:
        stiffness = found.rate * (system.motion.end - system.motion.begin)
        return (
            f"{where} {MILD}, since it needs {evaluations} evaluations, below the "
            f"{PATIENCE} up to which nothing else is tried; stiffness λΔt is {stiffness:.3g} "
            f"(λ = {found.rate:.3g}/s)"
        )
    why = f"would take about {expected:.0f} evaluations" if expected else "cannot go on"
    return f"{where} {found.method}, since at first {MILD} {why}; {found.reason}"
