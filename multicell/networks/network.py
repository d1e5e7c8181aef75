"""A network inside a cell: what is known of it by name, and the functions that compute with it.

Its states y follow dy/dt = rates(t, y, u, p), with inputs u that its surroundings set at each time
and parameters p that are constant but for events. Time is in the unit of the network's own,
``time_unit`` seconds, and so are all values. A network from a file and one written in Python are
the same thing from here on.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, final


@final
@dataclass(frozen=True, eq=False)
class Event:
    """A sudden change of states and parameters, where a condition turns true.

    - ``trigger``: ``trigger(t, y, u, p) -> float``; the condition holds where this is above zero,
      nowhere else. It fires where it turns true, and the time is found as a root
    - ``assign``: ``assign(t, y, u, p, y_then, p_then)`` writes y and p in place, from the values
      at which the condition turned true: they are others where events of one time come before
    - ``persistent``: whether it is executed although an event of the same time made its condition
      false
    - ``initial``: whether the condition counts as true before the start; where it does not, a
      condition that holds at the start fires then
    - ``priority``: of events at the same time that with the larger one is first; None: last, in
      the order of the network
    """

    name: str
    trigger: Callable[..., float]
    assign: Callable[..., None]
    persistent: bool = True
    initial: bool = True
    priority: float | None = None


@final
@dataclass(frozen=True, eq=False)
class Network:
    """A system of ordinary differential equations that each cell of a kind has one of.

    - ``states``, ``start``: names of y and its values at the start
    - ``inputs``, ``defaults``: names of u, and its values where a scene sets none
    - ``parameters``, ``values``: names and values of p
    - ``observed``: names of further values that follow from these, such as rates of reactions
    - ``rates``: ``rates(t, y, u, p, out)`` writes dy/dt; numba can compile it
    - ``observe``: ``observe(t, y, u, p, out)`` writes the values of ``observed``; None where there
      are none
    - ``units``: name -> unit, as far as the model states them
    - ``amounts``: states that are amounts and halve at a division; the others are concentrations
    - ``time_unit``: s per unit of its time, or None where the model states none
    - ``source``: text of all that is computed, which its fingerprint is made of
    - ``initial``: ``initial(u, p, y)`` writes y at the start, and of p what follows from others;
      None where ``start`` and ``values`` are all there is. They hold its result at ``defaults``
    - ``computed``: parameters that ``initial`` writes, which nothing else can set
    """

    name: str
    states: tuple[str, ...]
    start: tuple[float, ...]
    inputs: tuple[str, ...]
    defaults: tuple[float, ...]
    parameters: tuple[str, ...]
    values: tuple[float, ...]
    observed: tuple[str, ...]
    rates: Callable[..., None]
    observe: Callable[..., None] | None
    source: str
    events: tuple[Event, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    amounts: frozenset[str] = frozenset()
    time_unit: float | None = None
    initial: Callable[..., None] | None = None
    computed: frozenset[str] = frozenset()

    def __post_init__(self) -> None:
        """Refuse names that stand for two things, and numbers that are not as many as names."""
        names = [*self.states, *self.inputs, *self.parameters, *self.observed]
        twice = sorted(name for name, count in Counter(names).items() if count > 1)
        if twice:
            raise ValueError(f"network {self.name!r} has two things named {twice[0]!r}")
        pairs: Any = (
            ("states", self.states, self.start),
            ("inputs", self.inputs, self.defaults),
            ("parameters", self.parameters, self.values),
        )
        for what, named, numbers in pairs:
            if len(named) != len(numbers):
                raise ValueError(
                    f"network {self.name!r} has {len(named)} {what} and {len(numbers)} values"
                )
        if bool(self.observed) != (self.observe is not None):
            raise ValueError(f"network {self.name!r} needs observe for its observed values")
