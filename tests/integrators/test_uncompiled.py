"""Kernels that Python calls must have what Python needs: without, a call ends in a crash."""

import importlib
import pkgutil
from types import FunctionType

import pytest
from numba.core.dispatcher import Dispatcher

from multicell.integrators import loops, stepping

LOOPS = [
    importlib.import_module(f"{loops.__name__}.{found.name}")
    for found in pkgutil.iter_modules(loops.__path__)
]


def called(function):
    """Return the jitted functions that a function names."""
    names = function.__code__.co_names
    found = {name: function.__globals__.get(name) for name in names}
    return {name: value for name, value in found.items() if isinstance(value, Dispatcher)}


def run_by_python():
    """Give the functions that are called from Python uncompiled, with what they are in."""
    for module in (stepping, *LOOPS):
        for value in vars(module).values():
            body = value.py_func if isinstance(value, Dispatcher) else value
            # one is compiled only, the other names it for its address
            other = body in (stepping._evaluation, stepping.stepping_kernels)
            if isinstance(body, FunctionType) and not other:
                yield body


FUNCTIONS = {f"{body.__module__}.{body.__qualname__}": body for body in run_by_python()}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_what_runs_uncompiled_calls_nothing_that_only_kernels_can_call(name):
    wrong = [
        other
        for other, dispatcher in called(FUNCTIONS[name]).items()
        if dispatcher.targetoptions.get("no_cpython_wrapper")
    ]
    assert wrong == []


def test_the_functions_looked_at_are_those_that_call_kernels():
    loops_found = [name for name in FUNCTIONS if ".loops." in name and called(FUNCTIONS[name])]
    assert len(loops_found) > 10
