"""What a scene says of reactions between its fields, in fixed forms: mass action and Hill terms."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import MISSING
from typing import Any, Protocol, final

from multicell.errors import SceneError
from multicell.scene.nutrient import MOST
from multicell.schema import (
    choice,
    measure,
    number,
    parameters,
    quantities,
    quantity,
    tables,
)
from multicell.units import to_base

UNITS = ("mM/s", "1/s", "1/mM/s", "1/mM^2/s", "1/mM^3/s")
"""Units of a rate constant by the order of its reaction, mM^(1 - n)/s."""

_LEAST, _LARGEST = 1e-15, 1e12
_ORDER = len(UNITS) - 1


@final
@parameters
class HillTerm:
    """A factor g^n / (half^n + g^n) of a field's concentration g, or one less that."""

    half: float = quantity("mM", above=0, at_most=MOST, doc="concentration of half the effect")
    exponent: float = number(
        default=1.0,
        at_least=1,
        at_most=16,
        doc="n; 1 is Michaelis and Menten's",
        hint="Below 1 the rate would have no derivative where there is nothing.",
    )


@final
@parameters
class Reaction:
    """A reaction between fields.

    ``mass-action``: ``rate`` times the concentrations of all that is consumed, each to the power
    of its number. ``hill``: ``rate`` times g^n / (half^n + g^n) for each field of
    ``activated_by`` and half^n / (half^n + g^n) for each of ``inhibited_by``.
    """

    kind: str = choice(["mass-action", "hill"], default="mass-action", doc="form of the rate")
    rate: float = measure(
        default=MISSING,
        doc="mass-action: rate constant, mM^(1 - n)/s at order n; hill: largest rate, mM/s",
    )
    consumes: Mapping[str, float] | None = quantities(
        "", at_least=1, at_most=4, doc="how many of each field are used up, whole numbers"
    )
    produces: Mapping[str, float] | None = quantities(
        "", at_least=1, at_most=4, doc="how many of each field are made, whole numbers"
    )
    activated_by: Mapping[str, HillTerm] = tables(
        HillTerm, doc="fields that a hill rate rises with"
    )
    inhibited_by: Mapping[str, HillTerm] = tables(
        HillTerm, doc="fields that a hill rate falls with"
    )
    where: str = choice(
        ["everywhere", "tissue", "medium"],
        default="everywhere",
        doc="tissue: in proportion to what cells fill of a place, medium: to the rest",
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
        self._check_hill() if self.kind == "hill" else self._check_mass_action()
        object.__setattr__(self, "rate", self._in_base_units())

    def _check_hill(self) -> None:
        if not self.activated_by and not self.inhibited_by:
            hint = "A reaction at a constant rate is of kind 'mass-action', and consumes nothing."
            raise SceneError("activated_by", "is missing in a reaction of kind 'hill'", hint)
        for field in self.consumes or ():
            if field not in self.activated_by:
                problem = "is consumed, but the rate does not end where there is none of it"
                raise SceneError(f"activated_by.{field}", f"is missing: {field} {problem}")

    def _check_mass_action(self) -> None:
        for name in ("activated_by", "inhibited_by"):
            if getattr(self, name):
                problem = "has no meaning in a reaction of kind 'mass-action'"
                raise SceneError(name, problem, "Kind 'hill' has such terms.")
        if self.order > _ORDER:
            problem = f"are {self.order} in all, must be at most {_ORDER}"
            raise SceneError("consumes", problem, "Write it as several steps.")

    def _in_base_units(self) -> float:
        given: Any = self.rate
        if isinstance(given, str):
            try:
                given = to_base(given, self.unit, "rate")
            except SceneError as error:
                what = "hill" if self.kind == "hill" else f"mass-action of order {self.order}"
                problem = f"{error.problem} (a reaction of kind {what} has {self.unit})"
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
        return "mM/s" if self.kind == "hill" else UNITS[self.order]

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
        named = (self.consumes or {}, self.produces or {}, self.activated_by, self.inhibited_by)
        return list(dict.fromkeys(name for table in named for name in table))


class Joining(Protocol):
    """What joins fields: a reaction of a scene, or one of the user's own."""

    @property
    def fields(self) -> Sequence[str]:
        """Names of the fields that it changes or depends on."""


def groups(names: Iterable[str], reactions: Mapping[str, Joining]) -> list[list[str]]:
    """Return the fields that react with each other, directly or over others, in their order."""
    order = list(names)
    found: list[set[str]] = []
    for reaction in reactions.values():
        joined = set(reaction.fields)
        apart = [group for group in found if not group & joined]
        found = [*apart, joined.union(*(group for group in found if group & joined))]
    lists = [[name for name in order if name in group] for group in found]
    return sorted(lists, key=lambda group: order.index(group[0]))


def group_of(name: str, reactions: Mapping[str, Joining]) -> list[str]:
    """Return the fields that react with a field, itself included; none if it takes no part."""
    known = dict.fromkeys(field for x in reactions.values() for field in x.fields)
    for group in groups(known, reactions):
        if name in group:
            return group
    return []
