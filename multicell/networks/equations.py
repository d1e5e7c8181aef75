"""The equations of a document laid out in arrays, and the code of the functions that compute them.

y holds the states, u the inputs and p the constants in the order of the document; what follows from
them is computed in the order of sbmlode's, and only where a function needs it.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable, Sequence
from functools import cached_property, partial
from itertools import chain
from typing import Any, Final, final

from sbmlode.astutil import is_number
from sbmlode.astutil import name as named

from multicell.errors import SceneError
from multicell.networks.expressions import ExpressionWriter, names_in

_SIGNATURES: Final = {
    "rates": "t, y, u, p, out",
    "observe": "t, y, u, p, out",
    "initial": "u, p, y",
    "trigger": "t, y, u, p",
    "assign": "t, y, u, p, y_then, p_then",
}
_AT_ROOT: Final = "1e-300"
"""What a condition that holds at its root is there, above all rounding and below all values."""


@final
class Equations:
    """A system of equations with some of its quantities as inputs.

    - ``states``, ``inputs``, ``parameters``, ``observed``: names in the order of the arrays
    - ``events``: those that change anything
    - ``computed``: parameters whose values follow from others at the start
    - ``used``: parameters that any of the functions reads, once :meth:`text` has been called
    """

    def __init__(self, system: Any, inputs: Sequence[str]) -> None:
        self.system, self.inputs = system, tuple(inputs)
        self._rules = {one.variable: one.math for one in system.assignments}
        for name in self.inputs:
            self._check_input(name)
        self.states = tuple(name for name in system.states if name not in self.inputs)
        self.observed = tuple(system.assigned)
        self.events = [event for event in system.events if self._changes(event)]
        first = {one.variable for one in system.initial}
        known = [q for q in system.quantities if q.role == "constant"]
        self.parameters = tuple(
            q.symbol.sid
            for q in known
            if q.symbol.sid not in self.inputs and self._is_needed(q, first)
        )
        self.computed = tuple(name for name in self.parameters if name in first)
        self.used: set[str] = set()
        self._operations = [0]
        self._functions = {f.symbol.sid: (f.arguments, f.body) for f in system.functions}
        self._places: dict[str, tuple[str, int]] = {}
        for array, names in zip("yup", (self.states, self.inputs, self.parameters), strict=True):
            self._places |= {name: (array, k) for k, name in enumerate(names)}

    @cached_property
    def _read(self) -> set[str]:
        """Names that any formula reads."""
        system = self.system
        trees = [one.math for one in (*system.assignments, *system.initial)]
        trees += [ode.rhs for ode in system.odes]
        for event in system.events:
            trees += [event.trigger, event.root]
            trees += chain(*((a.math, a.scale) for a in event.assignments))
        return set().union(*(names_in(tree) for tree in trees if tree is not None))

    def _is_needed(self, quantity: Any, first: set[str]) -> bool:
        """Return whether a constant is of any use: formulas read it, or it has a value to show."""
        name, has_value = quantity.symbol.sid, quantity.value is not None
        return name in self._read or (
            quantity.symbol.kind != "species_reference" and (has_value or name in first)
        )

    def _check_input(self, name: str) -> None:
        system = self.system
        known = {q.symbol.sid: q for q in system.quantities}
        if name not in known:
            near = difflib.get_close_matches(name, known, 1, 0.5)
            hint = f"Did you mean '{near[0]}'?" if near else ""
            raise SceneError("", f"has no '{name[:80]}' that could be an input", hint)
        ruled = {ode.variable for ode in system.odes if ode.origin != "reactions"}
        changed = {a.variable for e in system.events for a in e.assignments if a.math is not None}
        kind = known[name].symbol.kind
        sizes = [q.symbol.sid for q in system.compartments if q.role == "assigned"]
        reasons = (
            (name in self._rules, "an assignment rule gives it"),
            (name in ruled, "it has a rate of its own"),
            (name in changed, "an event changes it"),
            (kind not in ("species", "parameter"), f"it is a {kind.replace('_', ' ')}"),
            (name in self._behind(sizes), "the size of a compartment depends on it"),
        )
        for holds, reason in reasons:
            if holds:
                raise SceneError("", f"cannot have '{name}' as an input: {reason}")

    def _behind(self, names: Iterable[str]) -> set[str]:
        """Return all that some quantities depend on, with themselves."""
        found, left = set(names), list(names)
        while left:
            tree = self._rules.get(left.pop())
            new = (names_in(tree) if tree is not None else set()) - found
            found |= new
            left += new
        return found

    def text(self) -> str:
        """Return the code of all functions."""
        parts = [self._function("rates", self._rates)]
        if self.observed:
            parts.append(self._function("observe", self._observed))
        parts.append(self._function("initial", self._initial))
        for event in self.system.events:
            late = event.delay is not None and not is_number(event.delay, 0.0)
            if late or event.priority is not None or event.root is None:
                raise SceneError("", f"has the event '{event.symbol.sid}', which is not read")
        for k, event in enumerate(self.events):
            parts.append(self._function(f"trigger{k}", partial(self._trigger, event)))
            parts.append(self._function(f"assign{k}", partial(self._assign, event)))
        return "\n\n".join(parts)

    def _function(self, name: str, write: Callable[[ExpressionWriter], None]) -> str:
        writer = ExpressionWriter(self._functions, self._operations)
        write(writer)
        body = "".join(f"    {line}\n" for line in writer.lines or ["pass"])
        return f"def {name}({_SIGNATURES[name.rstrip('0123456789')]}):\n{body}"

    def _scope(
        self, writer: ExpressionWriter, trees: Iterable[Any], suffix: str = ""
    ) -> dict[str, str]:
        """Write all that some formulas read; return what stands for each name.

        - ``suffix``: of the arrays from which states and constants are read
        """
        needed = self._behind(set().union(*map(names_in, trees)))
        names = {}
        for name, (array, k) in self._places.items():
            if name in needed:
                names[name] = f"{array}{k}"
                source = array if array == "u" else f"{array}{suffix}"
                writer.lines.append(f"{array}{k} = {source}[{k}]")
        self.used |= needed & set(self.parameters)
        for k, (name, tree) in enumerate(self._rules.items()):
            if name in needed:
                code = writer.value(tree, names)
                writer.lines.append(f"a{k} = {code}")
                names[name] = f"a{k}"
        return names

    def _rates(self, writer: ExpressionWriter) -> None:
        rates = {ode.variable: ode.rhs for ode in self.system.odes}
        names = self._scope(writer, [rates[name] for name in self.states])
        for k, name in enumerate(self.states):
            code = writer.value(rates[name], names)
            writer.lines.append(f"out[{k}] = {code}")

    def _observed(self, writer: ExpressionWriter) -> None:
        names = self._scope(writer, map(named, self.observed))
        for k, name in enumerate(self.observed):
            writer.lines.append(f"out[{k}] = {names[name]}")

    def _initial(self, writer: ExpressionWriter) -> None:
        written = {one.variable: one.math for one in self.system.initial}
        for name in self.inputs:
            written.pop(name, None)
        needed = set().union(*map(names_in, written.values())) - written.keys()
        names = {}
        for name in needed & self._places.keys():
            array, k = self._places[name]
            names[name] = f"{array}{k}"
        writer.lines.append("t = 0.0")
        for code in sorted(names.values()):
            writer.lines.append(f"{code} = {code[0]}[{code[1:]}]")
        self.used |= needed & set(self.parameters)
        for k, (name, tree) in enumerate(written.items()):
            code = writer.value(tree, names)
            writer.lines.append(f"i{k} = {code}")
            names[name] = f"i{k}"
            array, place = self._places.get(name, ("", 0))
            if array:
                writer.lines.append(f"{array}[{place}] = i{k}")

    def _changes(self, event: Any) -> list[Any]:
        return [a for a in event.assignments if a.variable not in self.inputs]

    def _trigger(self, event: Any, writer: ExpressionWriter) -> None:
        names = self._scope(writer, [event.root, event.trigger])
        root = writer.bound(writer.value(event.root, names))
        holds = writer.truth(event.trigger, names)
        at_root = f"({_AT_ROOT} if {holds} else -{_AT_ROOT})"
        writer.lines.append(f"return {at_root} if {root} == 0.0 else {root}")

    def _assign(self, event: Any, writer: ExpressionWriter) -> None:
        """Write new values; a concentration whose compartment changes keeps its amount."""
        changes = self._changes(event)
        suffix = "_then" if event.use_values_from_trigger_time else ""
        names = self._scope(writer, [a.math for a in changes if a.math is not None], suffix)
        new = {
            a.variable: "1.0" if a.math is None else writer.bound(writer.value(a.math, names))
            for a in changes
        }
        scaled = [a for a in changes if a.scale is not None]
        names = self._scope(writer, [a.scale for a in scaled])
        for a in scaled:
            scale = writer.value(a.scale, names)
            new[a.variable] = writer.bound(f"{new[a.variable]} * {scale}")
        for a in changes:
            if a.divisor is None:
                writer.lines.append(f"{self._place(a.variable)} = {new[a.variable]}")
        divided = [a for a in changes if a.divisor is not None]
        sizes = self._scope(writer, map(named, sorted({a.divisor for a in divided})))
        for a in divided:
            place, size = self._place(a.variable), sizes[a.divisor]
            writer.lines.append(f"{place} = {new[a.variable]} / {size}")

    def _place(self, name: str) -> str:
        array, k = self._places[name]
        return f"{array}[{k}]"
