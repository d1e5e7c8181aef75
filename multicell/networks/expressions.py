"""Arithmetic of SBML as lines of Python that numba compiles.

A formula comes as a tree of libSBML. What a node may be stands in the tables below, and whatever is
not there is refused by name. Nothing of a document gets into the code but numbers: every
identifier is replaced by a name of ours (``y3``, ``p0``), calls of function definitions by their
bodies. Long formulas become several lines, so that nothing is nested deeply.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any, Final, final

import libsbml

from multicell.errors import SceneError

_LONGEST: Final = 240  # characters of an expression: fewer than 200 brackets, the most Python reads
_WIDEST: Final = 16  # operands of a sum or product on one line
_MAX_OPERATIONS: Final = 100_000  # of all code of a network: numba compiles about 1,000 a second
_MAX_POWER: Final = 16  # up to this one, whole powers are multiplied out

_FUNCTIONS: Final = {
    libsbml.AST_FUNCTION_ABS: "abs({})",
    libsbml.AST_FUNCTION_ARCCOS: "np.arccos({})",
    libsbml.AST_FUNCTION_ARCCOSH: "np.arccosh({})",
    libsbml.AST_FUNCTION_ARCCOT: "np.arctan(1.0 / {})",
    libsbml.AST_FUNCTION_ARCCOTH: "np.arctanh(1.0 / {})",
    libsbml.AST_FUNCTION_ARCCSC: "np.arcsin(1.0 / {})",
    libsbml.AST_FUNCTION_ARCCSCH: "np.arcsinh(1.0 / {})",
    libsbml.AST_FUNCTION_ARCSEC: "np.arccos(1.0 / {})",
    libsbml.AST_FUNCTION_ARCSECH: "np.arccosh(1.0 / {})",
    libsbml.AST_FUNCTION_ARCSIN: "np.arcsin({})",
    libsbml.AST_FUNCTION_ARCSINH: "np.arcsinh({})",
    libsbml.AST_FUNCTION_ARCTAN: "np.arctan({})",
    libsbml.AST_FUNCTION_ARCTANH: "np.arctanh({})",
    libsbml.AST_FUNCTION_CEILING: "np.ceil({})",
    libsbml.AST_FUNCTION_COS: "np.cos({})",
    libsbml.AST_FUNCTION_COSH: "np.cosh({})",
    libsbml.AST_FUNCTION_COT: "(1.0 / np.tan({}))",
    libsbml.AST_FUNCTION_COTH: "(1.0 / np.tanh({}))",
    libsbml.AST_FUNCTION_CSC: "(1.0 / np.sin({}))",
    libsbml.AST_FUNCTION_CSCH: "(1.0 / np.sinh({}))",
    libsbml.AST_FUNCTION_EXP: "np.exp({})",
    libsbml.AST_FUNCTION_FACTORIAL: "math.gamma({} + 1.0)",
    libsbml.AST_FUNCTION_FLOOR: "np.floor({})",
    libsbml.AST_FUNCTION_LN: "np.log({})",
    libsbml.AST_FUNCTION_SEC: "(1.0 / np.cos({}))",
    libsbml.AST_FUNCTION_SECH: "(1.0 / np.cosh({}))",
    libsbml.AST_FUNCTION_SIN: "np.sin({})",
    libsbml.AST_FUNCTION_SINH: "np.sinh({})",
    libsbml.AST_FUNCTION_TAN: "np.tan({})",
    libsbml.AST_FUNCTION_TANH: "np.tanh({})",
}
_OF_TWO: Final = {
    libsbml.AST_DIVIDE: "({} / {})",
    libsbml.AST_FUNCTION_QUOTIENT: "np.trunc({} / {})",
    libsbml.AST_FUNCTION_REM: "np.fmod({}, {})",
}
_OF_MANY: Final = {
    libsbml.AST_PLUS: ("({})", " + ", "0.0"),
    libsbml.AST_TIMES: ("({})", " * ", "1.0"),
    libsbml.AST_FUNCTION_MAX: ("max({})", ", ", ""),
    libsbml.AST_FUNCTION_MIN: ("min({})", ", ", ""),
}
"""How operands are joined, by what, and what none of them are."""
_FROM_LEFT: Final = (
    libsbml.AST_PLUS,
    libsbml.AST_MINUS,
    libsbml.AST_TIMES,
    libsbml.AST_DIVIDE,
)
_POWERS: Final = (libsbml.AST_POWER, libsbml.AST_FUNCTION_POWER)
_NUMBERS: Final = (
    libsbml.AST_INTEGER,
    libsbml.AST_REAL,
    libsbml.AST_REAL_E,
    libsbml.AST_RATIONAL,
    libsbml.AST_NAME_AVOGADRO,
)
_CONSTANTS: Final = {libsbml.AST_CONSTANT_E: math.e, libsbml.AST_CONSTANT_PI: math.pi}
_TRUTHS: Final = {libsbml.AST_CONSTANT_TRUE: True, libsbml.AST_CONSTANT_FALSE: False}
_RELATIONS: Final = {
    libsbml.AST_RELATIONAL_EQ: "==",
    libsbml.AST_RELATIONAL_GEQ: ">=",
    libsbml.AST_RELATIONAL_GT: ">",
    libsbml.AST_RELATIONAL_LEQ: "<=",
    libsbml.AST_RELATIONAL_LT: "<",
    libsbml.AST_RELATIONAL_NEQ: "!=",
}
_LOGIC: Final = (
    libsbml.AST_LOGICAL_AND,
    libsbml.AST_LOGICAL_IMPLIES,
    libsbml.AST_LOGICAL_NOT,
    libsbml.AST_LOGICAL_OR,
    libsbml.AST_LOGICAL_XOR,
)
_TRUE, _FALSE = "(1.0 > 0.0)", "(1.0 < 0.0)"


def children_of(tree: Any) -> list[Any]:
    """Return the operands of a node."""
    return [tree.getChild(k) for k in range(tree.getNumChildren())]


def nodes_of(tree: Any) -> list[Any]:
    """Return a node and all below it."""
    found, left = [], [tree]
    while left:
        found.append(left.pop())
        left += children_of(found[-1])
    return found


def names_in(tree: Any) -> set[str]:
    """Return the identifiers of quantities that a formula reads."""
    return {node.getName() for node in nodes_of(tree) if node.getType() == libsbml.AST_NAME}


@final
class ExpressionWriter:
    """Writes formulas as lines of one function; each result is an expression for the next one.

    - ``functions``: name -> arguments and body of the function definitions, none of which calls
      itself by way of others
    - ``operations``: how many nodes have been written, over all writers that share it
    """

    def __init__(
        self, functions: Mapping[str, tuple[Sequence[str], Any]], operations: list[int]
    ) -> None:
        self._functions, self._operations = functions, operations
        self._count = 0
        self.lines: list[str] = []

    def bound(self, code: str) -> str:
        """Return the name of a local variable that holds the value of an expression."""
        name = f"v{self._count}"
        self._count += 1
        self.lines.append(f"{name} = {code}")
        return name

    def value(self, tree: Any, names: Mapping[str, str]) -> str:
        """Return a formula as an expression for a number.

        - ``names``: what stands for each identifier
        """
        return self._short(self._value(tree, names))

    def truth(self, tree: Any, names: Mapping[str, str]) -> str:
        """Return a formula as an expression for a condition; a number holds unless it is zero."""
        return self._short(self._truth(tree, names))

    def _short(self, code: str) -> str:
        return code if len(code) <= _LONGEST else self.bound(code)

    def _counted(self, tree: Any) -> int:
        self._operations[0] += 1
        if self._operations[0] > _MAX_OPERATIONS:
            most = f"{_MAX_OPERATIONS:,}"
            raise SceneError("", f"has more than {most} operations, function definitions expanded")
        return int(tree.getType())

    def _value(self, tree: Any, names: Mapping[str, str]) -> str:
        kind = self._counted(tree)
        if kind in _NUMBERS:
            return literal(tree.getValue())
        if kind in _CONSTANTS:
            return literal(_CONSTANTS[kind])
        if kind == libsbml.AST_NAME_TIME:
            return "t"
        if kind == libsbml.AST_NAME:
            return self._name(tree, names)
        if kind == libsbml.AST_FUNCTION:
            return self._call(tree, names, self.value)
        if kind in _TRUTHS or kind in _RELATIONS or kind in _LOGIC:
            return f"(1.0 if {self._truth(tree, names)} else 0.0)"
        if kind == libsbml.AST_FUNCTION_PIECEWISE:
            return self._piecewise(tree, names)
        if kind in _FROM_LEFT:
            return self._chain(tree, names)
        given = [self.value(child, names) for child in children_of(tree)]
        return self._operation(tree, kind, given)

    def _chain(self, tree: Any, names: Mapping[str, str]) -> str:
        """Return operations whose first operand is one again, as in a + b - c, without recursion.

        Level 1 and some programs write long sums so.
        """
        chain = [tree]
        while chain[-1].getNumChildren() > 1 and chain[-1].getChild(0).getType() in _FROM_LEFT:
            chain.append(chain[-1].getChild(0))
            self._counted(chain[-1])
        first = children_of(chain[-1])[:1]
        given = [self.value(one, names) for one in first]
        for node in reversed(chain):
            given += [self.value(one, names) for one in children_of(node)[1:]]
            given = [self._short(self._operation(node, int(node.getType()), given))]
        return given[0]

    def _operation(self, tree: Any, kind: int, given: list[str]) -> str:
        count = len(given)
        if kind in _FUNCTIONS and count == 1:
            return _FUNCTIONS[kind].format(*given)
        if kind in _OF_TWO and count == 2:
            return _OF_TWO[kind].format(*given)
        if kind in _OF_MANY and (given or _OF_MANY[kind][2]):
            return self._joined(*_OF_MANY[kind], given)
        if kind == libsbml.AST_MINUS and count in (1, 2):
            return f"({given[0]} - {given[1]})" if count == 2 else f"(-{given[0]})"
        if kind in _POWERS and count == 2:
            return _power(given[0], given[1])
        if kind == libsbml.AST_FUNCTION_ROOT and count in (1, 2):
            square = count == 1 or given[0] == "2.0"
            return f"np.sqrt({given[-1]})" if square else f"({given[1]} ** (1.0 / {given[0]}))"
        if kind == libsbml.AST_FUNCTION_LOG and count in (1, 2):
            ten = count == 1 or given[0] == "10.0"
            ratio = f"(np.log({given[-1]}) / np.log({given[0]}))"
            return f"np.log10({given[-1]})" if ten else ratio
        formula = str(libsbml.formulaToL3String(tree))[:80]
        raise SceneError("", f"has '{formula}', which is not among the arithmetic that is read")

    def _joined(self, form: str, by: str, none: str, given: list[str]) -> str:
        if not given:
            return none
        while len(given) > _WIDEST:
            given = [self.bound(form.format(by.join(given[:_WIDEST]))), *given[_WIDEST:]]
        return given[0] if len(given) == 1 else form.format(by.join(given))

    def _name(self, tree: Any, names: Mapping[str, str]) -> str:
        name = str(tree.getName())
        if name not in names:
            raise SceneError("", f"has a formula of '{name[:80]}', which the model does not define")
        return names[name]

    def _call(
        self, tree: Any, names: Mapping[str, str], write: Callable[[Any, Mapping[str, str]], str]
    ) -> str:
        name, given = str(tree.getName()), children_of(tree)
        if name not in self._functions:
            raise SceneError("", f"calls '{name[:80]}', which is no function of it")
        arguments, body = self._functions[name]
        if len(arguments) != len(given):
            raise SceneError("", f"calls '{name[:80]}' with {len(given)} arguments")
        codes = [self.value(one, names) for one in given]
        codes = [code if len(code) < 24 else self.bound(code) for code in codes]
        return write(body, dict(zip(arguments, codes, strict=True)))

    def _piecewise(self, tree: Any, names: Mapping[str, str]) -> str:
        parts = children_of(tree)
        code = self.value(parts.pop(), names) if len(parts) % 2 else "np.nan"
        for value, condition in reversed(list(zip(parts[0::2], parts[1::2], strict=True))):
            holds = self.truth(condition, names)
            code = self._short(f"({self.value(value, names)} if {holds} else {code})")
        return code

    def _truth(self, tree: Any, names: Mapping[str, str]) -> str:
        kind = int(tree.getType())
        if kind in _TRUTHS:
            return _TRUE if _TRUTHS[kind] else _FALSE
        if kind == libsbml.AST_FUNCTION:
            return self._call(tree, names, self.truth)
        if kind in _RELATIONS:
            self._counted(tree)
            given = [self.value(child, names) for child in children_of(tree)]
            pairs = [f"({a} {_RELATIONS[kind]} {b})" for a, b in pairwise(given)]
            return self._all(pairs, "and")
        if kind in _LOGIC:
            self._counted(tree)
            return self._logic(tree, kind, [self.truth(one, names) for one in children_of(tree)])
        return f"({self._value(tree, names)} != 0.0)"

    def _logic(self, tree: Any, kind: int, given: list[str]) -> str:
        if kind == libsbml.AST_LOGICAL_AND:
            return self._all(given, "and")
        if kind == libsbml.AST_LOGICAL_OR:
            return self._all(given, "or") if given else _FALSE
        if kind == libsbml.AST_LOGICAL_XOR:
            code = _FALSE
            for one in given:
                code = self._short(f"({code} != {one})")
            return code
        if kind == libsbml.AST_LOGICAL_NOT and len(given) == 1:
            return f"(not {given[0]})"
        if kind == libsbml.AST_LOGICAL_IMPLIES and len(given) == 2:
            return f"((not {given[0]}) or {given[1]})"
        return self._operation(tree, kind, given)

    def _all(self, given: list[str], by: str) -> str:
        return self._joined("({})", f" {by} ", _TRUE, given)


def literal(value: float) -> str:
    """Return a number as code."""
    value = float(value)
    if math.isnan(value):
        return "np.nan"
    if math.isinf(value):
        return "np.inf" if value > 0.0 else "(-np.inf)"
    return repr(value) if math.copysign(1.0, value) > 0.0 else f"({value!r})"


def _power(base: str, exponent: str) -> str:
    """Return a power; whole ones as literal integers, which compilers multiply out."""
    plain = exponent.strip("()")
    try:
        number = float(plain)
    except ValueError:
        number = math.nan
    if number.is_integer() and abs(number) <= _MAX_POWER:
        return f"({base} ** {int(number)})" if number >= 0.0 else f"({base} ** ({int(number)}))"
    return f"({base} ** {exponent})"
