"""What is changed of numba's insides for speed does what numba's own did.

Of the rest of the table in ``multicell/compiling/numba_068.py``: stamps in ``test_stale_code``,
folders and files of others in ``cli/test_closed_folders``, boxes and signals in
``test_interrupts``, types that are gone and the collector in ``test_compiling``.
"""

import subprocess
import sys

import numpy as np
import pytest
from llvmlite import ir
from numba import njit
from numba.core.compiler import Flags
from numba.core.registry import cpu_target

import multicell.compiling  # noqa: F401 - changes numba

DOUBLE = ir.DoubleType()


@pytest.mark.parametrize(
    "kind",
    [
        ir.IntType(8),
        ir.IntType(32),
        DOUBLE,
        ir.LiteralStructType([ir.IntType(8), DOUBLE]),
        ir.ArrayType(DOUBLE, 7),
        ir.LiteralStructType([ir.ArrayType(ir.IntType(8), 3), ir.IntType(16)]),
    ],
    ids=str,
)
def test_the_size_of_a_type_is_that_of_llvm(kind):
    context = cpu_target.target_context
    for _ in range(2):
        assert context.get_abi_sizeof(kind) == kind.get_abi_size(context.target_data)


def test_options_are_equal_where_all_their_values_are():
    one, other, third = Flags(), Flags(), Flags()
    third.error_model = "numpy"
    assert one == other
    assert hash(one) == hash(other)
    assert one != third
    other.error_model = "numpy"  # set or not, it is the value that counts
    assert other == third
    other.error_model = one.error_model
    assert one == other
    assert one != "numpy"


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


BLAS = """
import sys
from multicell.mechanics import forces
print("scipy.linalg" in sys.modules)
import numpy as np
from numba import njit
square = njit(lambda a: a @ a)
print(np.array_equal(square(np.eye(3) * 2.0), np.eye(3) * 4.0), "scipy.linalg" in sys.modules)
"""


def test_linear_algebra_is_loaded_where_a_kernel_calls_it():
    done = subprocess.run([sys.executable, "-c", BLAS], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "True", "True"]
