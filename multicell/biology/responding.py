"""Responses of cells to signals: the values of behaviours.

Several responses of one behaviour combine by a rule. With v the value without any, v_k that of
response k alone, all of them of the same cell:

- ``product``: v Π v_k/v, the rule of factors;
- ``sum``: max(0, v + Σ (v_k - v)), the rule of rates: causes of death compete;
- ``minimum`` and ``maximum``: of v_k;
- ``physicell``: with X_k = h_k / (1 - h_k) for the share h_k of the full effect, and
  U = Σ X / (1 + Σ X) over the responses that raise the value and D over those that lower it,
  (1 - D) ((1 - U) v + U v_up) + D v_down, v_up the largest and v_down the least of their values;
  for types with a response by the law ``constant`` v is its value.

A response of some types takes the place of one of all types with the same behaviour and signal.

References
----------
J. A. I. Johnson et al., "Human interpretable grammar encodes multicellular systems biology models
to democratize virtual cell laboratories", Cell 188 (2025), for the rule of PhysiCell.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, Final, cast, final

import numpy as np
from numpy.typing import NDArray

from multicell import random
from multicell.behaviours.catalogue import CONTACTS, FULL_CROWDING, PHASE, needs_contacts
from multicell.cells import Phase, contact_rows
from multicell.random import Purpose
from multicell.scene.responses import Effect, effects, usual_type
from multicell.vectors import lengths, nearest_differences, wrapped

if TYPE_CHECKING:
    from multicell.biology.plan import BiologyPlan
    from multicell.cells import Cells, FloatArray, IntArray, Mask, Signals
    from multicell.scene.scene import Scene


_OF_CELLS: Final = ("age", "volume", "radius")
_RATES: Final = ("apoptosis rate", "damage rate")


Level = Callable[["Signals", "Cells | None", "FloatArray | None"], Any]
"""Function that returns a signal, (n,), from fields, the cells and their pressure."""


@final
@dataclass(frozen=True, eq=False)
class BoundResponse:
    """A response ready for arrays of cells.

    - ``effect``: what it is in the scene
    - ``level``: returns its signal
    - ``needs``: names of all signals that it is made from
    - ``mask``, (types,) bool, or None: which types respond; None for all
    """

    effect: Effect
    level: Level
    needs: frozenset[str]
    mask: Mask | None

    @cached_property
    def yes_or_no(self) -> bool:
        """Whether its value is zero or one, as booleans."""
        ends = self.effect.low, self.effect.high
        return self.effect.law.jumps and ends == (0.0, 1.0)

    @property
    def is_local(self) -> bool:
        """Whether fields and pressure at a place are all that it depends on."""
        others = (name in _OF_CELLS or _is_elsewhere(name) for name in self.needs)
        return self.mask is None and not any(others)

    def share(
        self, signals: Signals, cells: Cells | None, pressure: FloatArray | None = None
    ) -> Any:
        """Return the share of the full effect, (n,); booleans for a threshold."""
        level = self.level(signals, cells, pressure)
        return self.effect.law.share(level, falls=self.effect.falls)

    def value(
        self, signals: Signals, cells: Cells | None, pressure: FloatArray | None = None
    ) -> Any:
        """Return the value of the behaviour under this response alone, (n,)."""
        share, low, high = self.share(signals, cells, pressure), self.effect.low, self.effect.high
        if low == 0.0 and high == 1.0:
            return share
        return np.where(share, high, low) if math.isinf(high) else low + (high - low) * share


Known = tuple[BoundResponse, ...]


def bind_responses(scene: Scene) -> dict[str, tuple[BoundResponse, ...]]:
    """Return the responses of each behaviour that has any, in the order of the scene."""
    kinds, known = list(scene.types), effects(scene)
    special: dict[tuple[str, tuple[str, ...]], set[str]] = {}
    for effect in known:
        if not effect.short:  # short forms of types exclude each other already
            special.setdefault((effect.behaviour, effect.signals), set()).update(effect.types)
    made: dict[str, list[BoundResponse]] = {}
    for effect in known:
        mask = None
        others = special.get((effect.behaviour, effect.signals), set())
        if effect.types or others:
            who = set(effect.types or kinds)
            who -= others if effect.short or not effect.types else set()
            mask = np.array([kind in who for kind in kinds])
        level, needs = _level(scene, effect.signals)
        bound = BoundResponse(effect, level, frozenset(needs), mask)
        made.setdefault(effect.behaviour, []).append(bound)
    return {name: tuple(bound) for name, bound in made.items()}


def _level(scene: Scene, signals: tuple[str, ...]) -> tuple[Level, set[str]]:
    """Return a function that reads signals, and the names of all that they are made from."""
    if not signals:
        return _count, set()
    levels, names = zip(*(one_level(scene, name) for name in signals), strict=True)
    if len(levels) == 1:
        return levels[0], names[0]
    return lambda *at: tuple(level(*at) for level in levels), set().union(*names)


def one_level(scene: Scene, name: str) -> tuple[Level, set[str]]:
    """Return a function that reads a signal, and the names of all that it is made from."""
    if name == "ATP":
        energy, fields = scene.energy, scene.nutrients
        assert energy is not None
        return lambda signals, *_: energy.supply(fields, signals), energy.fields(fields)
    if name == "pressure":
        return _pressure, {name}
    if name in _OF_CELLS:
        return lambda _, cells, __: getattr(cells, name), {name}
    return lambda signals, *_: signals[name], {name}


def _count(signals: Signals, cells: Cells | None, pressure: FloatArray | None) -> FloatArray:
    """Return zeros in the number of the cells."""
    like = cells.id if cells is not None else next(iter(signals.values()), pressure)
    return np.zeros(0 if like is None else len(like))


def _pressure(_: Signals, cells: Cells | None, pressure: FloatArray | None) -> FloatArray:
    return cast("Cells", cells).pressure if pressure is None else pressure


def value_of(
    plan: BiologyPlan,
    behaviour: str,
    own: float,
    signals: Signals,
    cells: Cells,
    *,
    early: bool = False,
) -> FloatArray | None:
    """Return the value of a behaviour of each cell, (n,), or None where nothing changes it.

    - ``behaviour``: its full name, such as ``"uptake of oxygen"``
    - ``signals``, name -> (n,): fields at the cells, and other signals that cells do not carry
      themselves
    - ``early``: whether fields may not be there yet: what responds to them then has no effect
    """
    known = plan.responses.get(behaviour)
    if known is None:
        return None
    if early:
        known = tuple(part for part in known if part.needs <= {*signals, *_OF_CELLS, "pressure"})
        if not known:
            return None
    out = combine_responses(known, own, signals, cells, cells.pressure)
    return (
        np.maximum(out, 0.0) if known[-1].effect.combine == "sum" and behaviour != "bias" else out
    )


def combine_responses(
    known: Known, own: float, signals: Signals, cells: Cells | None, pressure: FloatArray
) -> FloatArray:
    """Return the value that responses of one behaviour make of its own one, (n,)."""
    if not known:
        return np.full(len(pressure), own)
    out, rule = cast("FloatArray", own), known[-1].effect.combine  # a number for all cells at first
    if rule == "physicell":
        return _physicell(known, own, signals, cells, pressure)
    for place, part in enumerate(known):
        value = part.value(signals, cells, pressure)
        if rule == "product":
            new = out * value if own == 1.0 else out * (value / own)
        elif rule == "sum":
            new = out + (value - own)
        elif place == 0:  # what the scene gives counts only where no response applies
            new = value
        else:
            new = (np.minimum if rule == "minimum" else np.maximum)(out, value)
        out = new if part.mask is None else np.where(part.mask[_kind(cells)], new, out)
    return out


def _kind(cells: Cells | None) -> NDArray[np.int16]:
    assert cells is not None
    return cells.kind


def _physicell(
    known: Known, own: float, signals: Signals, cells: Cells | None, pressure: FloatArray
) -> FloatArray:
    """Return the values under PhysiCell's rule, (n,)."""
    base, graded = np.full(len(pressure), own), []
    for part in known:
        here = True if part.mask is None else part.mask[_kind(cells)]
        if not part.effect.law.has_signal:
            base = np.where(here, part.effect.high, base)
        else:
            graded.append((part, here))
    none = np.zeros(len(pressure))
    sums, ends = {True: none, False: none}, {True: base, False: base}
    for part, here in graded:
        # the value at a high signal decides whether the signal raises or lowers the behaviour
        effect = part.effect
        start, end = effect.low, effect.high
        if effect.falls:
            start, end = end, start
        rises, share = end > start, np.asarray(part.share(signals, cells, pressure), dtype=float)
        share = 1.0 - share if effect.falls else share
        with np.errstate(divide="ignore"):
            odds = share / (1.0 - share)
        sums[rises] = sums[rises] + np.where(here, odds, 0.0)
        farther = np.maximum if rises else np.minimum
        ends[rises] = np.where(here, farther(ends[rises], end), ends[rises])
    up, down = (1.0 - 1.0 / (1.0 + sums[rises]) for rises in (True, False))
    return np.asarray((1.0 - down) * ((1.0 - up) * base + up * ends[True]) + down * ends[False])


def wants_rest(plan: BiologyPlan, cells: Cells, signals: Signals) -> Mask:
    """Return which cells would rest here, (n,).

    A chance p is the part of cells that rest: each has its own level, drawn once for its life, and
    rests where p is above it. A threshold is p = 0 or 1.
    """
    resting: Any = False
    known = plan.responses.get("rest", ())
    graded = any(not part.yes_or_no for part in known)
    own = random.uniform(plan.seed, Purpose.REST, 0, cells.id)[:, 0] if graded else None
    for part in known:
        rests = part.value(signals, cells)
        rests = rests if part.yes_or_no else rests > own
        resting = resting | (rests if part.mask is None else rests & part.mask[cells.kind])
    return np.asarray(resting) if known else np.zeros(len(cells), dtype=np.bool_)


def rate_of_harm(
    plan: BiologyPlan, behaviour: str, signals: Signals, cells: Cells | None
) -> FloatArray | None:
    """Return the necrosis rate or the damage rate of each cell, (n,) 1/s; infinite: death at once.

    Short forms (thresholds of fields and ATP) have one rate in common, however many of them hold.
    None where nothing has this effect. Without ``cells`` only effects of fields on all types, and
    thresholds as the most numerous type at the start has them.
    """
    known = plan.responses.get(behaviour, ())
    if cells is None:
        known = tuple(_as_usual(plan, part) for part in known)
        known = tuple(part for part in known if part.is_local and "pressure" not in part.needs)
    hazard = None
    named = tuple(part for part in known if not part.effect.short)
    if named and named[-1].effect.combine == "physicell":
        pressure = _count(signals, None, None) if cells is None else cells.pressure
        hazard = combine_responses(named, 0.0, signals, cells, pressure)
        known = known[: -len(named)]
    for part in known:
        value = part.value(signals, cells)
        before: Any = 0.0 if hazard is None else hazard
        new = np.maximum(before, value) if part.effect.short else before + value
        hazard = new if part.mask is None else np.where(part.mask[_kind(cells)], new, before)
    return hazard


def _as_usual(plan: BiologyPlan, part: BoundResponse) -> BoundResponse:
    """Return a short form of the most numerous type as one of all cells, others as they are."""
    if part.mask is None or not part.effect.short:
        return part
    usual = list(plan.types).index(usual_type(plan.types))
    return replace(part, mask=None) if part.mask[usual] else part


def rate_of(plan: BiologyPlan, behaviour: str, signals: Signals, cells: Cells) -> FloatArray:
    """Return the rate of one of the behaviours that act by a rate, of each cell, (n,) 1/s."""
    if behaviour in ("necrosis rate", "damage rate"):
        rate = rate_of_harm(plan, behaviour, signals, cells)
    else:
        rate = value_of(plan, behaviour, plan.base_rates.get(behaviour, 0.0), signals, cells)
    return np.zeros(len(cells)) if rate is None else rate


def acting(responses: Mapping[str, Known]) -> tuple[str, ...]:
    """Return the behaviours that are rates, but for one that is death at once or none."""

    def acts(name: str, known: Known) -> bool:
        if name == "necrosis rate":
            return any(not math.isinf(part.effect.high) for part in known)
        return name in _RATES or name.startswith("change to ")

    return tuple(name for name, known in responses.items() if acts(name, known))


def exposed(responses: Mapping[str, Known]) -> frozenset[str]:
    """Return the signals that rates depend on, and death at once."""
    names = {*acting(responses), "necrosis rate"} & responses.keys()
    return frozenset(signal for name in names for part in responses[name] for signal in part.needs)


def counted(responses: Mapping[str, Known]) -> frozenset[str]:
    """Return the signals that count neighbours by state or type, and act by rates or at births."""
    at_birth = ("mutation to ", "asymmetric division to ")
    names = {*acting(responses), *(name for name in responses if name.startswith(at_birth))}
    signals = {signal for name in names for part in responses[name] for signal in part.needs}
    of_state = {"neighbours", "dead neighbours"}
    return frozenset(x for x in signals if x in of_state or x.startswith(CONTACTS))


def missing_signals(
    responses: Mapping[str, tuple[BoundResponse, ...]], inputs: frozenset[str] = frozenset()
) -> frozenset[str]:
    """Return the signals that neither fields nor cells carry: time, phases, networks, neighbours.

    - ``inputs``: signals that networks need
    """
    named = {name for known in responses.values() for part in known for name in part.needs}
    return frozenset(filter(_is_elsewhere, named | inputs))


def _is_elsewhere(name: str) -> bool:
    elsewhere = name == "time" or "." in name or name.startswith(PHASE)
    return elsewhere or needs_contacts(name)


def other_signals(
    plan: BiologyPlan, cells: Cells, contacts: IntArray, time: float
) -> dict[str, FloatArray]:
    """Return the signals besides fields that the responses of a plan need, name -> (n,).

    - ``contacts``, (m, 2): identities of the cells that touch
    - ``time``: simulated time, s
    """
    out = {}
    if "time" in plan.elsewhere:
        out["time"] = np.full(len(cells), time)
    for name in plan.elsewhere:
        if name.startswith(PHASE):
            out[name] = (cells.phase == Phase[name.removeprefix(PHASE)]).astype(float)
    counted = plan.elsewhere - {"time", *out}
    if not counted:
        return out
    if plan.networks is not None:
        near = partial(_weighted, cells, plan.period, contacts)
        out |= plan.networks.signals(counted, cells, time, near)
        counted = frozenset(name for name in counted if "." not in name)
        if not counted:
            return out
    pairs = contact_rows(cells, contacts)
    first, second = np.concatenate([pairs, pairs[:, ::-1]]).T
    names = list(plan.types)
    for name in sorted(counted):
        who, weight = np.ones(len(first), dtype=bool), None
        if name == "crowding":
            weight = _overlap(cells, first, second, plan.period) ** 2 / FULL_CROWDING
        elif name == "dead neighbours":
            who = cells.dead[second]
        elif name == "neighbours":
            who = ~cells.dead[second]
        else:
            kind = names.index(name.removeprefix(CONTACTS))
            who = (cells.kind[second] == kind) & ~cells.dead[second]
        out[name] = np.bincount(first[who], weight, minlength=len(cells)).astype(float)
    return out


def _weighted(
    cells: Cells, period: FloatArray | None, contacts: IntArray, weighted: bool
) -> tuple[IntArray, FloatArray]:
    """Return the cells that touch, (m, 2) rows, and their areas of contact, (m,) µm²; or ones.

    The area is that of Hertz's contact, π r h with 1/r = 1/r_i + 1/r_j: zero where cells that
    stick are further apart than the sum of their radii.
    """
    pairs = contact_rows(cells, contacts)
    if not weighted:
        return pairs, np.ones(len(pairs))
    first, second = pairs[:, 0], pairs[:, 1]
    product = cells.radius[first] * cells.radius[second]
    return pairs, np.pi * product * _overlap(cells, first, second, period)


def _overlap(
    cells: Cells, first: IntArray, second: IntArray, period: FloatArray | None
) -> FloatArray:
    """Return the overlap of pairs of cells over the sum of their radii, (m,), zero if apart."""
    distance = lengths(nearest_differences(cells.position[second], cells.position[first], period))
    reach = cells.radius[first] + cells.radius[second]
    return np.asarray(np.maximum(1.0 - distance / reach, 0.0))


def with_newborn(plan: BiologyPlan, cells: Cells, contacts: IntArray, first: int) -> IntArray:
    """Return contacts, (m, 2) identities, with those of cells born since, which are who overlap.

    - ``first``: identity of the first of these
    """
    if not any(map(needs_contacts, plan.elsewhere)):
        return contacts
    born = ((cells.id >= first) & ~cells.dead).nonzero()[0]
    if not born.size:
        return contacts
    from scipy.spatial import cKDTree

    period = plan.period
    reach = cells.radius[born] + float(cells.radius.max())
    place = cells.position if period is None else wrapped(cells.position, period)
    near = cKDTree(place, boxsize=period).query_ball_point(place[born], reach)
    one = np.repeat(born, [len(rows) for rows in near])
    other = np.concatenate([np.asarray(rows, dtype=np.int64) for rows in near])
    distance = lengths(nearest_differences(cells.position[other], cells.position[one], period))
    newborn = cells.id[other] >= first
    # a pair of two newborn cells is found from both sides
    keep = (distance < cells.radius[one] + cells.radius[other]) & (one != other)
    keep &= ~newborn | (one < other)
    return np.concatenate([contacts, cells.id[np.stack([one[keep], other[keep]], axis=1)]])
