"""A run: its state as a value, the coupling step that makes the next one, and who asks for it."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from multicell.simulation.simulation import Simulation as Simulation


def __getattr__(name: str) -> Any:
    """Load the simulation when it is asked for: numba takes its time, and checks need none."""
    if name == "Simulation":
        from multicell.simulation.simulation import Simulation

        return Simulation
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
