"""The balance of spherical shells in one pass, as :mod:`stencil` has it for boxes."""

from __future__ import annotations

from multicell.cells import FloatArray
from multicell.compiling import KERNEL, typed
from multicell.nutrient.uptake import uptake_and_slope

_jit = typed(**KERNEL)


@_jit
def shell_imbalance(
    c: FloatArray,
    sink: FloatArray,
    source: FloatArray,
    half: float,
    linear: float,
    conductance: FloatArray,
    leak: float,
    volumes: FloatArray,
    residual: FloatArray,
    rate: FloatArray,
) -> None:
    """Write sources minus sinks of all shells (mM/s) and the sinks' derivative (1/s).

    - ``c``, (n,), mM
    - ``sink``, ``source``, (n,), mM/s: largest uptake, and all that comes in without regard to c,
      over the surface too
    - ``half``, float, mM
    - ``linear``, float, 1/s
    - ``conductance``, (n - 1,), µm³/s: what flows through the spheres between shells for each mM of
      difference
    - ``leak``, float, µm³/s: what leaves through the surface for each mM in the last shell
    - ``volumes``, (n,), µm³
    - ``residual``, ``rate``, (n,): written
    """
    n = c.size
    inner = 0.0
    for i in range(n):
        outer = conductance[i] * (c[i + 1] - c[i]) if i < n - 1 else -leak * c[i]
        taken, slope = uptake_and_slope(sink[i], c[i], half)
        residual[i] = (outer - inner) / volumes[i] + source[i] - taken - linear * c[i]
        rate[i] = slope + linear
        inner = outer
