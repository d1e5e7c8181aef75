"""The functions of networks as compiled code at addresses.

One loop serves all networks: it calls their functions at addresses, and is compiled once. What
stands at an address is a small function of this package that is compiled for a *type*, whose name
is a fingerprint of the network's function and of all that it reads. So numba keeps it on disk
under that name, wherever the function was written, and never uses code that is out of date. The
type has no values: it takes no place among the arguments of the call.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, final

import numpy as np
from numba import njit
from numba.extending import overload, register_jitable

from multicell.cells import IntArray
from multicell.compiling import ADDRESSED, address_of
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


def network_part(code, t, y, u, p, out):
    """Stand for a function of a network, which is selected by the type of ``code``."""
    raise NotImplementedError


@overload(network_part, jit_options={"error_model": "numpy"})
def _five(code, t, y, u, p, out):
    function = _jitable(code)

    def call(code, t, y, u, p, out):
        function(t, y, u, p, out)

    return call


def trigger_part(code, t, y, u, p):
    """Stand for the condition of an event, which is selected by the type of ``code``."""
    raise NotImplementedError


@overload(trigger_part, jit_options={"error_model": "numpy"})
def _four(code, t, y, u, p):
    function = _jitable(code)

    def call(code, t, y, u, p):
        return function(t, y, u, p)

    return call


def assign_part(code, t, y, u, p, y_then, p_then):
    """Stand for the effect of an event, which is selected by the type of ``code``."""
    raise NotImplementedError


@overload(assign_part, jit_options={"error_model": "numpy"})
def _six(code, t, y, u, p, y_then, p_then):
    function = _jitable(code)

    def call(code, t, y, u, p, y_then, p_then):
        function(t, y, u, p, y_then, p_then)

    return call


def initial_part(code, u, p, y):
    """Stand for what computes a start, which is selected by the type of ``code``."""
    raise NotImplementedError


@overload(initial_part, jit_options={"error_model": "numpy"})
def _three(code, u, p, y):
    function = _jitable(code)

    def call(code, u, p, y):
        function(u, p, y)

    return call


def _jitable(code: Any) -> Callable[..., Any]:
    """Return the function that belongs to a type, ready to be compiled into another one."""
    function = _FUNCTIONS[code.instance_class.__name__]
    if hasattr(function, "py_func"):  # numba has it already
        return function
    for part in (*helpers_of(function), function):
        register_jitable(error_model="numpy")(part)
    return function


@njit(**ADDRESSED)
def _write(code, t, y, u, p, out):
    network_part(code, t, y, u, p, out)
    return t


@njit(**ADDRESSED)
def _trigger(code, t, y, u, p):
    return float(trigger_part(code, t, y, u, p))


@njit(**ADDRESSED)
def _assign(code, t, y, u, p, y_then, p_then):
    assign_part(code, t, y, u, p, y_then, p_then)
    return t


@njit(**ADDRESSED)
def _initial(code, u, p, y):
    initial_part(code, u, p, y)
    return 0.0


def addresses(network: Network) -> Addresses:
    """Return where the functions of a network are, compiled if need be.

    Raises
    ------
    SceneError
        If numba cannot compile one of them.
    """
    row = np.empty(0)
    four = 0.0, row, row, row
    events = network.events

    def at(driver: Any, function: Callable[..., Any], result: Any, arguments: Any) -> int:
        try:
            return address_of(driver, result, _stand_in(function), *arguments)
        except Exception as error:
            if not type(error).__module__.startswith("numba."):
                raise
            raise SceneError(f"networks.{network.name}", *_refusal(function, error)) from None

    observe, initial = network.observe, network.initial
    return Addresses(
        at(_write, network.rates, 0.0, (*four, row)),
        0 if observe is None else at(_write, observe, 0.0, (*four, row)),
        0 if initial is None else at(_initial, initial, 0.0, (row, row, row)),
        np.array([at(_trigger, e.trigger, 0.0, four) for e in events], dtype=np.int64),
        np.array([at(_assign, e.assign, 0.0, (*four, row, row)) for e in events], dtype=np.int64),
    )


def _refusal(function: Callable[..., Any], error: Exception) -> tuple[str, str]:
    name = getattr(function, "__name__", "a function")
    words = " ".join(str(error).split("\n\n")[0].split())[:400]
    hint = "Arithmetic on floats and arrays, math and NumPy functions are what it may use."
    return f"numba cannot compile {name!r}: {words}", hint


def _stand_in(function: Callable[..., Any]) -> Any:
    """Return the only value of the type that stands for a function."""
    name = f"Network_{fingerprint(function, modules=True)}"
    _FUNCTIONS.setdefault(name, function)
    return _type(name)()
