"""Fields of nutrients and signals: uptake, secretion, grids, solvers, balance.

Every run with a field loads py-pde, which imports ``scipy.integrate``, ``optimize`` and ``sparse``
for grids that no field here lives on. They take three quarters of its time, so they are loaded when
something of them is used. This stands here because modules of this room import py-pde themselves,
before those of ``equations``.
"""

from __future__ import annotations

import sys
from importlib.util import LazyLoader, find_spec, module_from_spec

import scipy


def _load_when_used(name: str) -> None:
    """Put a submodule of SciPy in its place that loads itself at its first use."""
    whole = f"scipy.{name}"
    spec = find_spec(whole)
    if whole in sys.modules or spec is None or spec.loader is None:
        return
    spec.loader = LazyLoader(spec.loader)
    module = module_from_spec(spec)
    sys.modules[whole] = module
    spec.loader.exec_module(module)
    setattr(scipy, name, module)  # `from scipy import integrate` must not look further


if "pde" not in sys.modules:
    for _name in ("integrate", "optimize", "sparse"):
        _load_when_used(_name)
