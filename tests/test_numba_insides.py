"""Changes of numba's insides for speed give the results of numba's own.

Of the rest of the table in ``multicell/compiling/numba_068.py``: stamps in ``test_stale_code``,
folders and files of others in ``cli/test_closed_folders``, boxes and signals in
``test_interrupts``, types that are gone and the collector in ``test_compiling``.
"""

import itertools
import math
import operator
import subprocess
import sys

import numpy as np
import pytest
from numba import njit, objmode, types
from numba.core.registry import cpu_target
from numba.core.types import functions
from numba.extending import overload

from multicell.compiling import numba_068  # changes numba


@pytest.mark.slow
def test_functions_of_numba_are_right_within_a_kernel_and_from_python():
    @njit
    def sorted_twice(values):
        made = np.empty(values.size)
        made[:] = np.sort(values)[::-1]
        return np.argsort(made), np.median(made), made.std()

    values = np.array([3.0, -1.0, 2.0, 8.0])
    order, middle, spread = sorted_twice(values)
    np.testing.assert_array_equal(order, np.argsort(np.sort(values)[::-1]))
    assert middle == np.median(values)
    assert spread == pytest.approx(values.std(), rel=1e-15)


def root_of(value):
    """Stand for what is compiled."""


@overload(root_of)
def _root_of(value):
    def run(value):
        if value < 0.0:
            raise ValueError("no root of", value)
        with objmode(found="float64"):
            found = math.sqrt(value)
        return found

    return run


def test_overloads_of_users_have_what_numba_gives_them():
    """An environment: without it neither ``objmode`` nor an exception with values works."""
    root = njit(lambda value: root_of(value))
    assert root(4.0) == 2.0
    with pytest.raises(ValueError, match=r"no root of.*-1\.0"):
        root(-1.0)


def test_operators_are_typed_once_and_as_numba_does(monkeypatch):
    tried = []

    class Tried(functions._ResolutionFailures):
        def __init__(self, context, function, *rest, **named):
            tried.append(function.typing_key)
            super().__init__(context, function, *rest, **named)

    context = cpu_target.typing_context
    context.refresh()
    monkeypatch.setattr(functions, "_ResolutionFailures", Tried)
    kinds = (types.int64, types.uint64, types.float32, types.float64, types.boolean)
    once = 5 * len(kinds) ** 2
    for again in range(2):
        tried.clear()
        for a, b in itertools.product(kinds, kinds):
            for name in ("mul", "add", "truediv", "lt", "floordiv"):
                own = context.resolve_value_type(getattr(operator, name))
                plain = numba_068._plain_call_type(own, context, (a, b), {})
                assert own.get_call_type(context, (a, b), {}) == plain
        # the second time only where numba is asked here
        assert (len(tried) == once) if again else (once < len(tried) <= 2 * once)


BLAS = """
import sys
from multicell.mechanics import forces
print("scipy.linalg" in sys.modules)
import numpy as np
from numba import njit
square = njit(lambda a: a @ a)
print(np.array_equal(square(np.eye(3) * 2.0), np.eye(3) * 4.0), "scipy.linalg" in sys.modules)
"""


@pytest.mark.slow
def test_linear_algebra_is_loaded_where_a_kernel_calls_it():
    done = subprocess.run([sys.executable, "-c", BLAS], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "True", "True"]
