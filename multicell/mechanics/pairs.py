"""The pair laws as the kernels call them: chosen by the type of a law's constants.

:func:`evaluate_pair` stands for the function of any law. Where numba meets it, the type of the
constants says which function is compiled in its place, and that is inlined: unused results among
force, stiffness and energy cost nothing, and laws that a scene does not use are not compiled.
"""

from __future__ import annotations

from typing import Any

from numba import types
from numba.extending import overload, register_jitable

from multicell.contact.constants import function_of
from multicell.plugins.fingerprints import helpers_of


def evaluate_pair(p, overlap, modulus, radius, rest, adhesion, unit, onset, slope, energy):
    """Return force (nN), stiffness (nN/µm) and energy (fJ) of a pair.

    The arguments are those of :mod:`multicell.contact.constants`; a law gets those that its
    function has. Where ``slope`` or ``energy`` is None, the caller does not use the stiffness or
    the energy; else they mean nothing.
    """
    found = function_of(p)
    values = {"rest": rest, "adhesion": adhesion, "unit": unit, "onset": onset}
    return found.whole(overlap, modulus, radius, p, *map(values.get, found.further))


@overload(evaluate_pair, jit_options={"error_model": "numpy", "forceinline": True})
def _compiled(p, overlap, modulus, radius, rest, adhesion, unit, onset, slope, energy):
    if not isinstance(p, types.BaseNamedTuple):
        return None
    found = function_of(p.instance_class)
    function = found.whole
    if isinstance(energy, types.NoneType):
        function = found.force_alone if isinstance(slope, types.NoneType) else found.without_energy
    for part in (*helpers_of(function), function):
        register_jitable(error_model="numpy", forceinline=True)(part)
    return _ADAPTERS[found.further](function)


def _bare(f: Any) -> Any:
    def law(p, overlap, modulus, radius, rest, adhesion, unit, onset, slope, energy):
        return f(overlap, modulus, radius, p)

    return law


def _with_rest(f: Any) -> Any:
    def law(p, overlap, modulus, radius, rest, adhesion, unit, onset, slope, energy):
        return f(overlap, modulus, radius, p, rest)

    return law


def _with_adhesion(f: Any) -> Any:
    def law(p, overlap, modulus, radius, rest, adhesion, unit, onset, slope, energy):
        return f(overlap, modulus, radius, p, adhesion)

    return law


def _with_both(f: Any) -> Any:
    def law(p, overlap, modulus, radius, rest, adhesion, unit, onset, slope, energy):
        return f(overlap, modulus, radius, p, rest, adhesion)

    return law


def _with_memory(f: Any) -> Any:
    def law(p, overlap, modulus, radius, rest, adhesion, unit, onset, slope, energy):
        return f(overlap, modulus, radius, p, adhesion, unit, onset)

    return law


_ADAPTERS = {
    (): _bare,
    ("rest",): _with_rest,
    ("adhesion",): _with_adhesion,
    ("rest", "adhesion"): _with_both,
    ("adhesion", "unit", "onset"): _with_memory,
}
