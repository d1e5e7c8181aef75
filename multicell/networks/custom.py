"""Networks of the user's own: a Python function becomes a network inside cells.

>>> import multicell as mc
>>> @mc.network(states={"H": 0.1}, inputs={"oxygen": 0.05}, parameters={"made": 1.0, "lost": 2.0})
... def hypoxia(t, y, u, p, out):
...     out[0] = p[0] - p[1] * u[0] * y[0]
>>> hypoxia.states
('H',)
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from inspect import signature
from typing import Any, Final, cast

from multicell.networks.network import Event, Network
from multicell.plugins.fingerprints import fingerprint
from multicell.plugins.laws import Laws

OWN_NETWORKS: Final[Laws[Any]] = Laws({})
"""Networks of the user's own by ``file.py:name``."""

_ARGUMENTS: Final = ("t", "y", "u", "p", "out")


def network(
    *,
    states: Mapping[str, float],
    inputs: Mapping[str, float] | Sequence[str] = (),
    parameters: Mapping[str, float] | None = None,
    observed: Sequence[str] = (),
    observe: Callable[..., None] | None = None,
    events: Iterable[Event] = (),
    units: Mapping[str, str] | None = None,
    amounts: Iterable[str] = (),
    time_unit: float | None = 1.0,
) -> Callable[[Callable[..., None]], Network]:
    """Make a network inside cells of a function that writes the rates of its states.

    The function is called as ``rates(t, y, u, p, out)`` and writes dy/dt to ``out``. ``y``, ``u``
    and ``p`` are arrays of states, inputs and parameters in the order in which they are named. It
    is compiled: arithmetic on floats, :mod:`math` and other such functions are what it may use.

    Parameters
    ----------
    states
        Name -> value at the start.
    inputs
        Name -> value where a scene sets none; or names alone, whose value is then 0.
    parameters
        Name -> value; a scene may set others, or draw them for each cell.
    observed, observe
        Names of further values, which ``observe(t, y, u, p, out)`` writes to ``out``.
    events
        What changes states and parameters at once (:class:`multicell.networks.network.Event`).
    units
        Of states, inputs, parameters and observed values; what has none is in the base units of
        the scene.
    amounts
        States that are amounts, and halve at a division; the others are concentrations.
    time_unit
        Seconds for each unit of ``t``; None: a scene states it.

    Returns
    -------
    A network: a scene takes it as ``networks.NAME.network``.

    Raises
    ------
    TypeError
        For a function with other arguments.
    ValueError
        For names that stand for two things, or that are none of its own.
    """

    def make(rates: Callable[..., None]) -> Network:
        written = [rates] if observe is None else [rates, observe]
        for function in written:
            found = tuple(signature(function).parameters)
            if found != _ARGUMENTS:
                raise TypeError(
                    f"{function.__name__}({', '.join(found)}) must have the arguments "
                    f"{', '.join(_ARGUMENTS)}"
                )
        given = inputs if isinstance(inputs, Mapping) else dict.fromkeys(inputs, 0.0)
        own, known = parameters or {}, tuple(events)
        stated = [
            dict(states),
            dict(given),
            dict(own),
            tuple(observed),
            dict(units or {}),
            sorted(amounts),
            time_unit,
        ]
        functions = [*written, *(part for e in known for part in (e.trigger, e.assign))]
        facts = [(e.name, e.persistent, e.initial, e.priority) for e in known]
        text = "\n".join([*map(fingerprint, functions), repr(stated), repr(facts)])
        mark = hashlib.sha256(text.encode()).hexdigest()[:12]
        code: Any = rates.__code__
        source = f"{os.path.basename(code.co_filename)}:{rates.__qualname__}"
        made = Network(
            name=f"{source}@{mark}",
            states=tuple(states),
            start=tuple(map(float, states.values())),
            inputs=tuple(given),
            defaults=tuple(map(float, given.values())),
            parameters=tuple(own),
            values=tuple(map(float, own.values())),
            observed=tuple(observed),
            rates=rates,
            observe=observe,
            source=text,
            events=known,
            units=dict(units or {}),
            amounts=frozenset(amounts),
            time_unit=time_unit,
        )
        _check_named(made)
        OWN_NETWORKS.add(source, mark, cast(Any, made))
        return made

    return make


def _check_named(network: Network) -> None:
    """Refuse units and amounts of what is not there."""
    everything = {*network.states, *network.inputs, *network.parameters, *network.observed}
    for name in (*network.units, *network.amounts):
        if name not in everything:
            raise ValueError(f"network {network.name!r} has nothing named {name!r}")
    for name in network.amounts - set(network.states):
        raise ValueError(f"{name!r} is no state, and cannot be an amount")
