"""Reactions between the fields of a scene, by the law of mass action."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import MISSING
from typing import Any, final

from multicell.errors import SceneError
from multicell.schema import choice, measure, parameters, quantities
from multicell.units import to_base

RATE_UNITS = ("mM/s", "1/s", "1/mM/s", "1/mM^2/s", "1/mM^3/s")
"""Units of a rate constant by the order of its reaction, mM^(1 - n)/s."""

_LEAST, _LARGEST = 1e-15, 1e12  # of a rate constant: beyond, no field can be computed
_ORDER = len(RATE_UNITS) - 1


@final
@parameters
class Reaction:
    """A reaction between fields by the law of mass action.

    It happens at ``rate`` times the concentrations of all that is consumed, each to the power of
    its number.
    """

    rate: float = measure(default=MISSING, doc="rate constant, mM^(1 - n)/s at order n")
    consumes: Mapping[str, float] | None = quantities(
        "", at_least=1, at_most=4, doc="how many of each field are used up, whole numbers"
    )
    produces: Mapping[str, float] | None = quantities(
        "", at_least=1, at_most=4, doc="how many of each field are made, whole numbers"
    )
    where: str = choice(
        ["everywhere", "tissue", "medium"],
        default="everywhere",
        doc="tissue: in proportion to the volume fraction of cells, medium: to the rest",
    )

    def check(self) -> None:
        """Raise ``SceneError`` for what is no reaction; turn the rate into base units."""
        for name in ("consumes", "produces"):
            for field, amount in (getattr(self, name) or {}).items():
                if amount != int(amount):
                    problem = f"is {amount:g}, must be a whole number"
                    raise SceneError(f"{name}.{field}", problem)
        if all(change == 0.0 for change in self.changes.values()):
            raise SceneError("consumes", "and produces change nothing", "Give one or both.")
        if self.order > _ORDER:
            problem = f"are {self.order} in all, must be at most {_ORDER}"
            raise SceneError("consumes", problem, "Write it as several steps.")
        object.__setattr__(self, "rate", self._in_base_units())

    def _in_base_units(self) -> float:
        given: Any = self.rate
        if isinstance(given, str):
            try:
                given = to_base(given, self.unit, "rate")
            except SceneError as error:
                problem = f"{error.problem} (a reaction of order {self.order} has {self.unit})"
                raise SceneError("rate", problem, error.hint) from None
        if not _LEAST <= given <= _LARGEST:
            problem = f"is {given:g} {self.unit}, must be from {_LEAST:g} to {_LARGEST:g}"
            raise SceneError("rate", problem)
        return float(given)

    @property
    def order(self) -> int:
        """How many particles must meet: the order of a mass-action rate."""
        return int(sum((self.consumes or {}).values()))

    @property
    def unit(self) -> str:
        """The unit of ``rate``."""
        return RATE_UNITS[self.order]

    @property
    def changes(self) -> dict[str, float]:
        """How many of each field one reaction makes (or uses up, below zero)."""
        found = {name: -amount for name, amount in (self.consumes or {}).items()}
        for name, amount in (self.produces or {}).items():
            found[name] = found.get(name, 0.0) + amount
        return found

    @property
    def fields(self) -> list[str]:
        """Names of the fields that it changes or depends on, each once."""
        return list(dict.fromkeys([*(self.consumes or {}), *(self.produces or {})]))


def groups(names: Iterable[str], reactions: Mapping[str, Any]) -> list[list[str]]:
    """Return the fields that react with each other, directly or over others, in their order.

    ``reactions`` are those of a scene, or of the user's own, which name their ``fields`` too.
    """
    order = list(names)
    found: list[set[str]] = []
    for reaction in reactions.values():
        joined = set(reaction.fields)
        apart = [group for group in found if not group & joined]
        found = [*apart, joined.union(*(group for group in found if group & joined))]
    lists = [[name for name in order if name in group] for group in found]
    return sorted(lists, key=lambda group: order.index(group[0]))


def group_of(name: str, reactions: Mapping[str, Any]) -> list[str]:
    """Return the fields that react with a field, itself included; none if it takes no part."""
    known = dict.fromkeys(field for x in reactions.values() for field in x.fields)
    for group in groups(known, reactions):
        if name in group:
            return group
    return []
