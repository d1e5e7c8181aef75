"""What our solvers of py-pde's kind need of an equation.

py-pde's own implicit solvers are fixed-point iterations, which fail beyond about the largest step
of an explicit one. Ours know more of an equation than its rates, which it offers by methods as
those of :class:`multicell.FieldEquation`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from multicell.errors import SceneError

if TYPE_CHECKING:
    from pde.pdes.base import PDEBase


def suitable(pde: PDEBase, state: Any, method: str) -> Any:
    """Return an equation that has the method by which a solver solves it."""
    if not hasattr(pde, method):
        problem = f"is {type(pde).__name__}, but multicell's solvers solve equations of fields only"
        raise SceneError("equation", problem, "Take one of py-pde's own solvers.")
    check = getattr(pde, "check", None)
    if check is not None:
        check(state)
    return pde
