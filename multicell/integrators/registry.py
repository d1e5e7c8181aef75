"""All methods by name. What is known of each stands in its own file, one line here names the file.

The files are light: compiled loops and solvers are loaded when a method first integrates.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from multicell.errors import SceneError
from multicell.integrators import (
    adams_bashforth,
    auto,
    backward_euler,
    cvode,
    rkc,
    rosenbrock,
    runge_kutta,
    scipy,
)
from multicell.integrators.base import MethodInfo, build_method, info_of
from multicell.units import whole_number

if TYPE_CHECKING:
    from multicell.integrators.base import Integrator
    from multicell.scene.parts import IntegratorOptions

_FAMILIES = (auto, cvode, backward_euler, runge_kutta, adams_bashforth, rkc, rosenbrock, scipy)

METHODS: dict[str, MethodInfo] = {
    info.name: info for family in _FAMILIES for info in map(info_of, family.METHODS)
}
"""Name of each method of integration -> what is known of it."""


def meant_by(name: str) -> str:
    """Return the method that a word of others stands for, or those of a kind, as a hint."""
    word = name.lower()
    for info in METHODS.values():
        if word in (*info.meant, info.name.removeprefix("scipy-") if info.outside else ""):
            return f"Did you mean '{info.name}'?"
    if word in ("explicit", "implicit"):
        kind = [info.name for info in METHODS.values() if info.implicit == (word == "implicit")]
        return f"The {word} ones are {', '.join(kind)}."
    return "Name none to compare all that can run the scene." if word == "all" else ""


def find(name: str) -> MethodInfo | None:
    """Return the information on a method, or on a variant such as ``"rkc2-5"``."""
    whole, _, digits = name.rpartition("-")
    number = whole_number(digits)
    if name in METHODS or whole not in METHODS or number is None:
        return METHODS.get(name)
    variant = METHODS[whole].variant
    return None if variant is None else variant(number)


def from_options(options: IntegratorOptions) -> Integrator:
    """Return the integrator that a scene asks for (see :class:`IntegratorOptions`).

    Raises SceneError if it is one of the user's own: what a scene names is never loaded.
    """
    if options.method not in METHODS:
        place = options.method.partition("(")[0]
        raise SceneError(
            "integrator.method",
            f"is {options.method!r}, a method of the user's own, which is not loaded by itself",
            f"Hand it over as integrator=..., or by --integrator '{place}' if the file is there.",
        )
    return instantiate(METHODS[options.method], options)


def instantiate(info: MethodInfo, options: IntegratorOptions) -> Integrator:
    """Return the integrator of a method with a scene's options."""
    fixed = {"step": options.step} if info.control == "step" else {}
    return build_method(
        info,
        rtol=options.rtol,
        atol=info.atol if options.atol is None else options.atol,
        max_steps=options.max_steps,
        max_displacement=options.max_displacement,
        **fixed,
    )
