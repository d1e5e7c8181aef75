"""Functions made of generated code, which is checked against a list before it is run.

Code is checked as Python reads it, node by node: it consists of functions of assignments and
arithmetic, with names and calls of the tables below. A second lock: the code was written from
tables already (:mod:`multicell.networks.expressions`). It is run as it was checked, from memory, in
a module called by a digest of its text. Compiled code on disk is known by the functions themselves
(:mod:`multicell.networks.code`), and asks for that module when it is loaded.
"""

from __future__ import annotations

import ast
import hashlib
import math
import re
import sys
from collections.abc import Callable, Mapping
from functools import cache
from types import ModuleType
from typing import Any, Final

import numpy as np

_NAME: Final = re.compile(r"[a-z]\d*|out|y_then|p_then|(rates|observe|initial)|(trigger|assign)\d+")
_ARRAYS: Final = ("y", "u", "p", "out", "y_then", "p_then")
_OF_NUMPY: Final = (
    "arccos",
    "arccosh",
    "arcsin",
    "arcsinh",
    "arctan",
    "arctanh",
    "ceil",
    "cos",
    "cosh",
    "exp",
    "floor",
    "fmod",
    "log",
    "log10",
    "sin",
    "sinh",
    "sqrt",
    "tan",
    "tanh",
    "trunc",
)
_CALLED: Final = ("abs", "max", "min", "math.gamma", *(f"np.{name}" for name in _OF_NUMPY))
_VALUES: Final = ("np.inf", "np.nan")
_NODES: Final = (
    ast.Module,
    ast.FunctionDef,
    ast.arguments,
    ast.arg,
    ast.Assign,
    ast.If,
    ast.Pass,
    ast.Return,
    ast.BinOp,
    ast.UnaryOp,
    ast.BoolOp,
    ast.Compare,
    ast.IfExp,
    ast.operator,
    ast.unaryop,
    ast.boolop,
    ast.cmpop,
    ast.expr_context,
)
"""Nodes that may stand anywhere; those with names and numbers have checks of their own."""


def functions_of(text: str) -> Mapping[str, Callable[..., Any]]:
    """Return the functions of generated code by name, the same ones for the same text.

    - ``text``: a module of functions of arithmetic

    Raises ValueError for code that is anything else.
    """
    module = _module(text)
    return {name: value for name, value in vars(module).items() if _NAME.fullmatch(name)}


@cache
def _module(text: str) -> ModuleType:
    check_code(text)
    name = f"network_{hashlib.sha256(text.encode()).hexdigest()[:32]}"
    module = ModuleType(name)
    vars(module).update(np=np, math=math)
    exec(compile(text, f"<{name}>", "exec"), vars(module))
    sys.modules[name] = module
    return module


def check_code(text: str) -> None:
    """Refuse code that is not arithmetic alone; ValueError with the place."""
    for node in ast.walk(ast.parse(text)):
        if not _is_allowed(node):
            line = getattr(node, "lineno", 0)
            raise ValueError(f"generated code has {type(node).__name__} in line {line}")


def _is_allowed(node: ast.AST) -> bool:
    if isinstance(node, ast.FunctionDef):
        bare = not node.decorator_list and node.returns is None
        return bare and _NAME.fullmatch(node.name) is not None
    if isinstance(node, ast.arguments):
        return not (node.defaults or node.kw_defaults or node.vararg or node.kwarg)
    if isinstance(node, ast.arg):
        return node.annotation is None and _NAME.fullmatch(node.arg) is not None
    if isinstance(node, ast.Name):
        known = node.id in ("np", "math", "abs", "max", "min") and isinstance(node.ctx, ast.Load)
        return known or _NAME.fullmatch(node.id) is not None
    if isinstance(node, ast.Constant):
        return type(node.value) in (int, float)
    if isinstance(node, ast.Attribute):
        loaded = isinstance(node.ctx, ast.Load)
        return loaded and ast.unparse(node) in (*_CALLED, *_VALUES)
    if isinstance(node, ast.Call):
        return not node.keywords and ast.unparse(node.func) in _CALLED
    if isinstance(node, ast.Subscript):
        array, place = node.value, node.slice
        whole = isinstance(place, ast.Constant) and isinstance(place.value, int)
        return isinstance(array, ast.Name) and array.id in _ARRAYS and whole
    return isinstance(node, _NODES)
