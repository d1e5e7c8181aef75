"""py-pde's own operators and interpolations as Python: the code that numba would compile."""

import ctypes
import importlib
import pkgutil
from contextlib import contextmanager

import numba
import pytest
from pde.backends import numba as made

for _module in pkgutil.walk_packages(made.__path__, f"{made.__name__}."):
    importlib.import_module(_module.name)  # or what others compile later would stay uncompiled


@contextmanager
def uncompiled():
    """Let what py-pde makes and calls within run without compilation, a second or more each.

    Only py-pde may run within: kernels that are imported there would stay uncompiled, too.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(numba.config, "DISABLE_JIT", 1)
        # py-pde's own where it is imported without compilation
        patch.setattr(
            made.utils, "address_as_void_pointer", lambda at: ctypes.cast(at, ctypes.c_void_p)
        )
        yield
