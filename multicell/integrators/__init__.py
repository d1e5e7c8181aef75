"""Integrators by name; each is loaded when it is asked for."""

from __future__ import annotations

from typing import TYPE_CHECKING

from multicell.integrators.names import METHODS

if TYPE_CHECKING:
    from multicell.integrators.base import Integrator
    from multicell.scene import IntegratorOptions

__all__ = ["METHODS", "make"]


def make(options: IntegratorOptions) -> Integrator:
    """Return the integrator that a scene asks for (see :class:`IntegratorOptions`)."""
    if options.method == "euler":
        from multicell.integrators.euler import Euler

        return Euler(options.step, options.max_displacement)
    if options.method == "cvode":
        from multicell.integrators.cvode import Cvode

        return Cvode(options.rtol, options.atol, options.max_steps, options.max_displacement)
    raise ValueError(f"no integrator is called {options.method!r}")
