"""Machinery of a run: biology's plan, mechanics and its integrator, fields, clocks.

It holds nothing of a run from step to step. Parts of a state are loaded into it before use.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, final

from multicell.biology.growth import growth_factor
from multicell.biology.motion import motion_of
from multicell.biology.plan import biology_plan
from multicell.biology.responding import other_signals, value_of
from multicell.nutrient.fields import FieldSystem
from multicell.simulation.mover import Mover
from multicell.simulation.timeline import TIMED_PHASES

if TYPE_CHECKING:
    from multicell.biology.plan import BiologyPlan
    from multicell.cells import Cells, FloatArray, IntArray, Signals
    from multicell.integrators.base import Integrator
    from multicell.mechanics.motion import Motion
    from multicell.nutrient.reactions.own import OwnReaction
    from multicell.scene.scene import Scene
    from multicell.simulation.run_state import RunState


def fields_of(
    scene: Scene, reactions: Mapping[str, OwnReaction] | None, threads: int, plan: BiologyPlan
) -> FieldSystem:
    """Return the fields of a scene, to which its cells respond."""
    networks = plan.networks
    if networks is None or not networks.change_fields:

        def respond(
            behaviour: str, cells: Cells, signals: Mapping[str, FloatArray]
        ) -> FloatArray | None:
            return value_of(plan, behaviour, 1.0, signals, cells, early=True)

        return FieldSystem(scene, reactions, threads, respond)

    from multicell.biology.inside import no_pairs

    def respond_inside(
        behaviour: str, cells: Cells, signals: Mapping[str, FloatArray]
    ) -> FloatArray | None:
        needs = {name for part in plan.responses.get(behaviour, ()) for name in part.needs}
        # fields respond to no neighbours
        inside = networks.signals(needs - {*signals}, cells, system.time, no_pairs)
        return value_of(plan, behaviour, 1.0, {**signals, **inside}, cells, early=True)

    system = FieldSystem(scene, reactions, threads, respond_inside, networks.fluxes)
    return system


@final
class Machinery:
    """Machinery that computes the steps of a run of a scene.

    - ``plan``: what biology needs of the scene
    - ``mover``: mechanics and the integrator
    - ``field_system``: what solves for the fields
    - ``wall``, phase -> s: wall time of each phase of the loop
    """

    def __init__(
        self,
        scene: Scene,
        threads: int,
        integrator: Integrator | None,
        reactions: Mapping[str, OwnReaction] | None,
    ) -> None:
        self.scene, self.plan = scene, biology_plan(scene)
        self.mover = Mover(scene, threads, integrator)
        self.field_system = fields_of(scene, reactions, threads, self.plan)
        self.wall = dict.fromkeys(TIMED_PHASES, 0.0)

    def load(self, state: RunState) -> None:
        """Let the parts continue from a state."""
        self.field_system.state, self.field_system.time = state.fields, state.timeline.time
        vars(self.mover.system.work).update(state.work)
        self.mover.system.learnt = tuple(state.learnt)
        if state.cavity is not None:
            self.mover.cavity = state.cavity

    def work(self) -> dict[str, int]:
        """Return the cost of the integration since the start of the run, by name."""
        return vars(self.mover.system.work).copy()

    def signals(self, cells: Cells, contacts: IntArray, time: float) -> Signals:
        """Return all that cells find and do not carry themselves: fields, time, neighbours.

        Fields are in mM; there are no more than responses need.
        """
        found = self.field_system.concentrations
        if not self.plan.elsewhere:
            return found
        return {**found, **other_signals(self.plan, cells, contacts, time)}

    def signals_of(self, state: RunState) -> Signals:
        """Return the signals that the cells of a state find."""
        return self.signals(state.cells, state.contacts, state.timeline.time)

    def growth(self, state: RunState, signals: Signals) -> FloatArray:
        """Return how fast cells of a state would grow where they find this, (n,)."""
        if state.growth is not None:
            return state.growth
        return growth_factor(self.plan, signals, state.cells.pressure, state.cells)

    def motion(
        self, state: RunState, signals: Signals, begin: float, end: float, radius: FloatArray
    ) -> Motion:
        """Return how the cells of a state move between two times, s, at whose end they have radii.

        - ``radius``, (n,) µm
        """
        gradients = self.field_system.gradients(state.cells)
        return motion_of(
            self.plan,
            state.cells,
            radius,
            begin,
            end,
            signals=signals,
            gradients=gradients,
            contacts=state.contacts,
            named=state.named,
        )
