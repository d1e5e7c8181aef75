"""The functions of networks as compiled code at addresses.

One loop serves all networks: it calls their functions at addresses, and is compiled once. What
stands at an address is a small function of this package that is compiled for a *type*, whose name
is a fingerprint of the network's function and of all that it reads. So numba keeps it on disk
under that name, wherever the function was written, and never uses code that is out of date. The
type has no values: it takes no place among the arguments of the call.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, NamedTuple, final

import numpy as np
from numba import carray, njit  # type: ignore[attr-defined]
from numba.extending import overload, register_jitable

from multicell.cells import IntArray
from multicell.compiling import ADDRESSED, address_of, floats_at
from multicell.errors import SceneError
from multicell.networks.network import Network
from multicell.plugins.fingerprints import fingerprint, helpers_of
from multicell.plugins.stand_ins import stand_in_types

_FUNCTIONS: dict[str, Callable[..., Any]] = {}
_type, __getattr__ = stand_in_types(__name__, "Network_", lambda name: ())


@final
class Addresses(NamedTuple):
    """Where the functions of a network are; 0 for absent ones.

    - ``triggers``, ``assigns``, (events,): those of its events
    """

    rates: int
    observe: int
    initial: int
    triggers: IntArray
    assigns: IntArray


def network_part(code, t, a, b, c, d, e):
    """Stand for a function of a network, which is selected by the type of ``code``.

    It is called with rows of floats that begin where the integers say, as long as the type says.
    """
    raise NotImplementedError


@overload(network_part, jit_options={"error_model": "numpy"})
def _part(code, t, a, b, c, d, e):
    name = code.instance_class.__name__
    function = _jitable(name)
    _, what, _, *lengths = name.split("_")
    i, j, k, m, n = [*map(int, lengths), 0, 0][:CALLED_ROWS]

    def write(code, t, a, b, c, d, e):
        function(t, row_at(a, i), row_at(b, j), row_at(c, k), row_at(d, m))
        return t

    def initial(code, t, a, b, c, d, e):
        function(row_at(a, i), row_at(b, j), row_at(c, k))
        return t

    def trigger(code, t, a, b, c, d, e):
        return float(function(t, row_at(a, i), row_at(b, j), row_at(c, k)))

    def assign(code, t, a, b, c, d, e):
        function(
            t,
            row_at(a, i),
            row_at(b, j),
            row_at(c, k),
            row_at(d, m),
            row_at(e, n),
        )
        return t

    return {"write": write, "initial": initial, "trigger": trigger, "assign": assign}[what]


@register_jitable
def row_at(place, count):
    """Return the row of so many floats that begins at a place in memory."""
    return carray(floats_at(place), count)


def _jitable(name: str) -> Callable[..., Any]:
    """Return the function that belongs to a type, ready to be compiled into another one."""
    function = _FUNCTIONS[name]
    if hasattr(function, "py_func"):  # numba has it already
        return function
    for part in (*helpers_of(function), function):
        register_jitable(error_model="numpy")(part)
    return function


@njit(**ADDRESSED)
def _driver(code, t, a, b, c, d, e):
    return network_part(code, t, a, b, c, d, e)


def addresses(network: Network) -> Addresses:
    """Return where the functions of a network are, compiled if need be.

    Raises
    ------
    SceneError
        If numba cannot compile one of them.
    """
    s, u, p = len(network.states), len(network.inputs), len(network.parameters)

    def at(what: str, function: Callable[..., Any] | None, *lengths: int) -> int:
        if function is None:
            return 0
        name = "_".join(map(str, ["Network", what, fingerprint(function, modules=True), *lengths]))
        _FUNCTIONS.setdefault(name, function)
        try:
            return address_of(_driver, 0.0, _type(name)(), 0.0, *[0] * CALLED_ROWS)
        except Exception as error:
            if not type(error).__module__.startswith("numba."):
                raise
            words = " ".join(str(error).split("\n\n")[0].split())[:400]
            named = getattr(function, "__name__", "a function")
            problem = f"numba cannot compile {named!r}: {words}"
            hint = "Arithmetic on floats and arrays, math and NumPy functions are what it may use."
            raise SceneError(f"networks.{network.name}", problem, hint) from None

    events = network.events
    return Addresses(
        at("write", network.rates, s, u, p, s),
        at("write", network.observe, s, u, p, len(network.observed)),
        at("initial", network.initial, u, p, s),
        np.array([at("trigger", e.trigger, s, u, p) for e in events], dtype=np.int64),
        np.array([at("assign", e.assign, s, u, p, s, p) for e in events], dtype=np.int64),
    )


CALLED_ROWS: Final = 5
"""Rows that each function at an address is given; some of them read fewer."""
