"""Constants of pair laws: NamedTuples whose type selects the law in the kernels.

The function of a law is written with bare floats and returns a tuple of force (nN), stiffness
dF/dh (nN/µm) and energy (fJ). It is called as ``function(overlap, modulus, radius, p, ...)`` with

=============  ====================================================================
``overlap``    h = r_i + r_j - distance, µm; below zero for spheres apart
``modulus``    E_ij, kPa (eq. 3.3)
``radius``     r_ij, µm (eq. 3.4)
``p``          the constants of the law
``rest``       r_i + r_j, µm                            } only where the function has
``adhesion``   √(6πσ_ij) of the pair, (nN/µm)^½         } an argument of that name,
``unit``       the law's own unit of overlap, µm        } in one of the orders of
``onset``      the overlap in it from which it acts     } :data:`FURTHER`
=============  ====================================================================

The name of a type of constants holds a fingerprint of the function, of all functions that it
calls and of the values that they read. Compiled code is kept on disk under the types of its
arguments: after a change of any of them it is not found again, wherever they are defined. The
tuples are flat, since numba's parallel loops take no others.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from inspect import signature
from typing import Any, final

from multicell.plugins.fingerprints import fingerprint
from multicell.plugins.stand_ins import stand_in_types

Function = Callable[..., Any]

TINY = 1e-300
"""Keeps 0 / 0 out of a law's function where there is no overlap, and numerator and all are zero."""
BASIC = ("overlap", "modulus", "radius", "p")  # the first arguments of the function of a law
FURTHER = ((), ("rest",), ("adhesion",), ("rest", "adhesion"), ("adhesion", "unit", "onset"))
"""What the arguments after those may be."""

SHARED = ("adhesion_constant", "bond_strength", "medium_drag")
"""What the kernels add to the constants of each law: √(6πσ) where it is one for all pairs, f_ad
of receptors in nN/µm² (None without any), and 6πη in kPa s."""


_type, __getattr__ = stand_in_types(
    __name__, "Constants_", lambda name: [*name.split("__")[1:], *SHARED], (0.0, None, 0.0)
)
_FUNCTIONS: dict[Any, LawFunction] = {}


@final
@dataclass(frozen=True)
class LawFunction:
    """The function of a law and the names of its further arguments.

    ``force_alone`` and ``without_energy`` are the same with zeros in the other places of the
    result, for laws whose stiffness or energy cost more than the force; else the function itself.
    """

    whole: Function
    further: tuple[str, ...]
    without_energy: Function
    force_alone: Function


def constants_of(
    function: Function,
    *fields: str,
    without_energy: Function | None = None,
    force_alone: Function | None = None,
) -> Any:
    """Return the type of a law's constants: a NamedTuple of floats with these fields.

    - ``without_energy``, ``force_alone``: see :class:`LawFunction`
    """
    for name in fields:
        if name in SHARED or name.startswith("_") or "__" in name:
            raise TypeError(f"{name!r} cannot be the name of a constant of a law")
    further = further_arguments(function)
    mark = fingerprint(function, modules=True)
    made = _type("__".join([f"Constants_{mark}", *fields]))
    _FUNCTIONS[made] = LawFunction(
        function, further, without_energy or function, force_alone or without_energy or function
    )
    return made


def further_arguments(function: Function) -> tuple[str, ...]:
    """Return the names of the arguments after the basic ones; TypeError if they are no law's."""
    found = tuple(signature(function).parameters)
    if found[: len(BASIC)] != BASIC or found[len(BASIC) :] not in FURTHER:
        orders = "; ".join(", ".join(names) or "no more" for names in FURTHER)
        raise TypeError(
            f"{function.__name__}({', '.join(found)}) must have the arguments {', '.join(BASIC)}, "
            f"and after them one of these: {orders}"
        )
    return found[len(BASIC) :]


def function_of(constants: Any) -> LawFunction:
    """Return the function of a law from its constants or their type."""
    return _FUNCTIONS[constants if isinstance(constants, type) else type(constants)]
