"""Explicit Euler with a fixed step, the method that is compared with most often."""

from multicell.integrators.explicit import Euler

__all__ = ["Euler"]
