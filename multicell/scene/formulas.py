"""Formulas of x, y and z that a scene states: arithmetic checked against a list, never run as code.

A formula is read as a tree of Python's syntax, and only what stands in the tables below is worked
out, by NumPy: numbers, x, y, z and pi, sums, products, powers, and functions of one or two numbers.
"""

from __future__ import annotations

import ast
import math
import sys
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from multicell.errors import SceneError

if TYPE_CHECKING:
    from multicell.vectors import FloatArray

_OPERATORS: Final[Mapping[type, Callable[..., Any]]] = {
    ast.Add: np.add,
    ast.Sub: np.subtract,
    ast.Mult: np.multiply,
    ast.Div: np.divide,
    ast.Pow: np.power,
    ast.UAdd: np.positive,
    ast.USub: np.negative,
}
_FUNCTIONS: Final[Mapping[str, tuple[Callable[..., Any], int]]] = {
    "abs": (np.abs, 1),
    "cos": (np.cos, 1),
    "exp": (np.exp, 1),
    "log": (np.log, 1),
    "max": (np.maximum, 2),
    "min": (np.minimum, 2),
    "sin": (np.sin, 1),
    "sqrt": (np.sqrt, 1),
    "step": (lambda x: np.heaviside(x, 1.0), 1),
    "tanh": (np.tanh, 1),
}
_NAMES: Final = ("x", "y", "z", "pi")
_LONGEST: Final = 1000  # characters
_DEEPEST: Final = 50  # brackets in brackets

FORMULA_HINT: Final = (
    f"Arithmetic of numbers, {', '.join(_NAMES)} with + - * / **, and the functions "
    f"{', '.join(_FUNCTIONS)}; step is 1 from zero on."
)


def formula_values(text: str, places: FloatArray, path: str) -> FloatArray:
    """Return the values of a formula at places (n, 3) in µm, (n,)."""
    x, y, z = places.T
    known = {"x": x, "y": y, "z": z, "pi": math.pi}
    with np.errstate(all="ignore"):  # what is not finite is for the caller to refuse
        found = _value(check_formula(text, path), known)
    return np.array(np.broadcast_to(found, len(places)), dtype=float)


def check_formula(text: str, path: str) -> ast.expr:
    """Return the tree of a formula; ``SceneError`` for one that is not arithmetic of x, y and z."""
    if len(text) > _LONGEST:
        raise SceneError(path, f"has {len(text):,} characters, must have at most {_LONGEST:,}")
    try:
        tree = ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, MemoryError, RecursionError):
        raise SceneError(path, f"is {text!r}, which is no formula", FORMULA_HINT) from None
    _check_node(tree, path, _DEEPEST)
    return tree


def _check_node(node: ast.expr, path: str, deep: int) -> None:
    """Refuse what is not in the tables."""
    parts: list[ast.expr] | None = None
    number = isinstance(node, ast.Constant) and type(node.value) in (int, float)
    if number and node.value > sys.float_info.max:  # type: ignore[attr-defined]
        raise SceneError(path, "has a number that is too large to compute with", FORMULA_HINT)
    if number or (isinstance(node, ast.Name) and node.id in _NAMES):
        parts = []
    elif isinstance(node, ast.UnaryOp) and type(node.op) in _OPERATORS:
        parts = [node.operand]
    elif isinstance(node, ast.BinOp) and type(node.op) in _OPERATORS:
        parts = [node.left, node.right]
    elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
        _, count = _FUNCTIONS.get(node.func.id, (None, -1))
        parts = node.args if len(node.args) == count else None
    if parts is None or deep == 0:
        what = ast.unparse(node)
        raise SceneError(path, f"has {what!r}, which no formula may have", FORMULA_HINT)
    for part in parts:
        _check_node(part, path, deep - 1)


def _value(node: ast.expr, known: Mapping[str, Any]) -> Any:
    if isinstance(node, ast.Constant):
        return float(node.value)  # type: ignore[arg-type]
    if isinstance(node, ast.Name):
        return known[node.id]
    if isinstance(node, ast.UnaryOp):
        return _OPERATORS[type(node.op)](_value(node.operand, known))
    if isinstance(node, ast.BinOp):
        both = _value(node.left, known), _value(node.right, known)
        return _OPERATORS[type(node.op)](*both)
    assert isinstance(node, ast.Call)
    assert isinstance(node.func, ast.Name)
    function, _ = _FUNCTIONS[node.func.id]
    return function(*(_value(part, known) for part in node.args))
