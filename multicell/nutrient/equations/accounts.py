"""A field equation that keeps its own account, for solvers that keep none.

The state carries, in further fields on the same grid, the time integrals of all that happens to
each substance, over the volume of the grid. Content less what came and plus what went is a linear
invariant of that system, and Runge-Kutta, multistep and implicit methods keep those to rounding:
the account of a run closes whatever solver of py-pde's brings its fields forward.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, final

import numpy as np
from pde.fields.collection import FieldCollection
from pde.fields.scalar import ScalarField
from pde.pdes.base import PDEBase

from multicell.cells import FloatArray
from multicell.nutrient.balance import COLUMNS

if TYPE_CHECKING:
    from collections.abc import Callable

    from multicell.nutrient.equations.equation import FieldEquation


@final
class AccountedEquation(PDEBase):  # type: ignore[no-untyped-call]
    """The equation of some fields and the integrals of what happens to them.

    - ``equation``: of the fields alone
    - ``until``, float, s: until when rates are asked for: what holds from then on does not count
    """

    def __init__(self, equation: FieldEquation, until: float = np.inf) -> None:
        super().__init__()
        self.equation, self.until = equation, until
        self._whole = equation.layout.whole
        self._nodes = math.prod(equation.layout.shape)
        self._number = len(equation.substances) * len(COLUMNS)
        self.explicit_time_dependence = equation.explicit_time_dependence

    def state(self, fields: Any) -> FieldCollection:
        """Return a state from one of the equation, with an account of nothing."""
        each = [fields] if isinstance(fields, ScalarField) else list(fields)
        more = math.ceil(self._number / self._nodes)
        account = [ScalarField(fields.grid, 0.0, label=f"account {i}") for i in range(more)]
        return FieldCollection([*each, *account])

    def account(self, data: FloatArray) -> FloatArray:
        """Return what has happened, (m, columns), with the columns of :data:`COLUMNS`."""
        m = len(self.equation.substances)
        kept = np.ravel(data[m:])[: self._number].reshape(m, len(COLUMNS)) * self._whole
        kept[:, COLUMNS.index("level")] /= self._whole
        return kept

    def rates(self, data: FloatArray, t: float) -> tuple[FloatArray, FloatArray]:
        """Return the rates of fields and account, and the derivative of all sinks (1/s)."""
        m, out, slope = len(self.equation.substances), np.zeros_like(data), np.zeros_like(data)
        t = min(t, float(np.nextafter(self.until, -np.inf)))
        out[:m], slope[:m] = self.equation.rates(data[:m], t)
        rows = self.equation.exchanges(data[:m], t)
        rows[:, [i for i, name in enumerate(COLUMNS) if name != "level"]] /= self._whole
        out[m:].reshape(-1)[: self._number] = rows.ravel()
        return out, slope

    def evolution_rate(self, state: Any, t: float = 0.0) -> Any:
        """Return the rates for py-pde's solvers."""
        result = state.copy()
        result.data[...], _ = self.rates(state.data, t)
        return result

    def shifted_inverse(
        self, data: FloatArray, t: float
    ) -> Callable[[FloatArray, float], FloatArray]:
        """Return a function of r and a shift (1/s) that gives about (shift - J)⁻¹ r."""
        m = len(self.equation.substances)
        inner = self.equation.shifted_inverse(data[:m], t)

        def inverse(r: FloatArray, shift: float) -> FloatArray:
            return np.concatenate([inner(r[:m], shift), r[m:] / shift])

        return inverse

    def switches(self, begin: float, end: float) -> list[float]:
        """Return the times strictly between two at which a medium jumps, s."""
        return self.equation.switches(begin, end)

    def growing(self, data: FloatArray) -> str:
        """Return in words which substance grows without bound; empty if none does."""
        return self.equation.growing(data[: len(self.equation.substances)])

    def check(self, state: Any) -> None:
        """Refuse nothing: the state is made by :meth:`state`."""
