"""The names of the methods; a light module, so that a scene can be read without loading them."""

from __future__ import annotations

METHODS: dict[str, str] = {
    "cvode": "implicit: SUNDIALS CVODE, BDF with Newton-Krylov",
    "euler": "explicit Euler with a fixed step",
}
"""Name of each integration method -> what it is, in one line."""
