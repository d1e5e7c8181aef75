"""Responses of a scene: behaviours of cells as functions of signals, and short keys for some.

A response lets one behaviour go from one value to another as a signal rises. Older keys of fields,
growth, death and energy (``growth_half_saturation``, ``necrosis`` ...) are short forms of
responses; both become :class:`Effect` here, and nothing else is evaluated in a run.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Final, final

from multicell.behaviours.catalogue import (
    COMBINE,
    CONTACTS,
    PHASE,
    SIGNALS,
    SURFACE_ENERGY,
    Behaviour,
    behaviour_named,
    signal_unit,
)
from multicell.behaviours.laws import (
    OWN_RESPONSES,
    RESPONSE_LAWS,
    LinearResponse,
    Monod,
    ResponseLaw,
    Threshold,
)
from multicell.cells import Phase
from multicell.errors import SceneError
from multicell.plugins.named import OWN_OBJECT
from multicell.scene.checks import check_kinds
from multicell.scene.dependences import followed
from multicell.scene.networks import check_kinds_have, check_network_signal, network_signals
from multicell.scene.oxygen import check_dissolves, concentration, is_oxygen
from multicell.scene.pairs import largest_energy
from multicell.scene.parts import CellType, loaded_in
from multicell.scene.ranges import check_overlap
from multicell.scene.reactions import group_of
from multicell.schema import (
    Bounds,
    Tables,
    below,
    build_part,
    choice,
    flag,
    measure,
    measure_points,
    near_miss,
    number,
    parameters,
    quantities,
    separated,
    specs,
    text,
)
from multicell.schema.bounds import reader, rises

if TYPE_CHECKING:
    from multicell.scene.scene import Scene


_ABSENT: Final[Mapping[str, Any]] = {
    **dict.fromkeys(("signal", "half", "begin", "end", "points", "parameters", "base", "largest")),
    "power": 1.0,
    "falls": False,
}
"""Keys that not all laws have -> their value where they are absent."""


@final
@parameters
class Response:
    """How a behaviour of cells responds to a signal.

    The value goes from ``base`` to ``largest`` as the signal rises, or with ``falls`` from
    ``largest`` to ``base``. What is absent of the two is what the scene gives without responses (1
    for a factor), or zero for the ``base`` of a response that falls.
    """

    behaviour: str = text(doc="behaviour that changes, such as 'growth rate' or 'uptake of oxygen'")
    signal: str | None = text(
        default=None,
        doc="a field, pressure, ATP, age ...; of a law of the user's "
        "own several, separated by commas; absent for the law 'constant'",
    )
    cells: str | None = text(default=None, doc="types, separated by commas; absent: all cells")
    law: str = choice(
        RESPONSE_LAWS,
        default="hill",
        doc="by which it responds",
        other=loaded_in(OWN_RESPONSES),
        further=OWN_OBJECT,
    )
    falls: bool = flag(default=False, doc="whether the effect falls as the signal rises")
    half: float | str | None = measure(doc="signal of half the effect, or the threshold")
    power: float = number(default=1.0, above=0, at_most=32, doc="Hill's exponent")
    begin: float | str | None = measure(doc="of the law 'linear': signal at which it begins")
    end: float | str | None = measure(doc="of the law 'linear': signal at which it ends")
    points: tuple[tuple[float | str, float | str], ...] | None = measure_points(
        doc="of the law 'table': [signal, value] of the behaviour"
    )
    base: float | str | None = measure(doc="value without the effect")
    largest: float | str | None = measure(doc="value at the full effect")
    combine: str | None = choice(
        COMBINE,
        default=None,
        doc="with other responses of the behaviour; absent: factors by "
        "product, rates by sum, rest by maximum",
    )
    parameters: Mapping[str, float] | None = quantities("", doc="of a law of the user's own")

    def check(self) -> None:
        """Raise ``SceneError`` for a law without its keys, or with those of another one."""
        law = RESPONSE_LAWS.get(self.law, ResponseLaw)
        for name, absent in _ABSENT.items():
            given = getattr(self, name) not in (absent, "")
            if name in law.needs and not given:
                raise SceneError(name, f"is missing: the law is {self.law!r}")
            if given and name not in (*law.needs, *law.may_have):
                raise SceneError(name, f"has no effect: the law is {self.law!r}")

    @property
    def signals(self) -> tuple[str, ...]:
        """The signals by name."""
        return separated(self.signal)

    @property
    def types(self) -> tuple[str, ...]:
        """The types that respond; empty for all cells."""
        return separated(self.cells)


@final
@dataclass(frozen=True)
class Effect:
    """A response with all that it needs, in base units.

    - ``behaviour``: full name
    - ``signals``: by name; empty for a constant
    - ``falls``: whether the effect falls as the signal rises
    - ``low``, ``high``: values of the behaviour where the share of the effect is zero and one.
      ``high`` is infinite for a death at once.
    - ``types``: that respond; empty for all
    - ``combine``: the rule
    - ``key``: dotted key of the scene that says so
    - ``short``: whether that key is a short form
    """

    behaviour: str
    signals: tuple[str, ...]
    law: ResponseLaw
    falls: bool
    low: float
    high: float
    types: tuple[str, ...]
    combine: str
    key: str
    short: bool = False


def effects(scene: Scene) -> tuple[Effect, ...]:
    """Return all responses of a scene, short forms first."""
    named = (_effect(scene, name, part) for name, part in scene.responses.items())
    return (*_short_forms(scene), *named)


def relevant_fields(scene: Scene) -> set[str]:
    """Return the fields that matter to cells, fields and reactions of a scene."""
    read = {*followed(scene), *(part.oxygen for part in scene.radiation.values())}
    read |= {signal for effect in effects(scene) for signal in effect.signals}
    read |= {signal for part in scene.networks.values() for signal in (part.inputs or {}).values()}
    read |= set() if scene.growth is None else scene.growth.signals
    for field in scene.nutrients.values():
        read |= {*field.uptake_on, *(field.secretion_from or ())}
    for reaction in scene.reactions.values():
        read |= set(reaction.fields)
    return read | set(() if scene.energy is None else scene.energy.yields or ())


def largest_factor(scene: Scene, behaviour: str) -> tuple[float, str]:
    """Return the largest factor that responses make of a behaviour, and the key that raises it.

    At least one, then with an empty key.
    """
    known = [x for x in effects(scene) if x.behaviour == behaviour]
    most = {x.key: x.law.most(x.low, x.high) for x in known}
    if not most or max(most.values()) <= 1.0:
        return 1.0, ""
    key, rule = max(most, key=lambda name: most[name]), known[-1].combine
    raised = [max(value, 1.0) for value in most.values()]
    factor = math.prod(raised) if rule == "product" else max(raised)
    return sum(x - 1.0 for x in raised) + 1.0 if rule == "sum" else factor, key


def own_value(scene: Scene, behaviour: Behaviour) -> float:
    """Return the value of a behaviour without responses, in its unit."""
    if behaviour.is_factor:
        return 1.0
    if behaviour.name == "apoptosis rate" and scene.death is not None:
        return scene.death.apoptosis_rate
    if behaviour.name == "bias" and scene.motility is not None:
        return scene.motility.bias
    return 0.0


def _short_forms(scene: Scene) -> Iterator[Effect]:
    """Yield the effects that keys of fields, energy and growth stand for, in order."""
    death, dying, what_kills = scene.death, math.inf, "necrosis rate"
    if death is not None and death.damage_time is not None:
        dying, what_kills = 1.0 / death.damage_time, "damage rate"
    elif death is not None and death.necrosis_rate is not None:
        dying = death.necrosis_rate

    def short(
        what: str,
        signal: str,
        law: ResponseLaw,
        key: str,
        falls: bool,
        high: float = 1.0,
        types: tuple[str, ...] = (),
    ) -> Effect:
        combine = behaviour_named(what, key)[0].combine
        return Effect(what, (signal,), law, falls, 0.0, high, types, combine, key, short=True)

    def needs(part: Any, signal: str, path: str) -> Iterator[Effect]:
        """Yield the needs of cells of a field or of ATP."""
        laws: dict[str, tuple[str, Any, bool, float]] = {
            "growth_half_saturation": ("growth rate", Monod, False, 1.0),
            "growth_inhibition": ("growth rate", Monod, True, 1.0),
            "quiescence": ("rest", Threshold, True, 1.0),
            "necrosis": (what_kills, Threshold, True, dying),
            "necrosis_above": (what_kills, partial(Threshold, strict=True), False, dying),
        }
        for key, (what, law, falls, high) in laws.items():
            if getattr(part, key, None) is None:
                continue
            for level, types in _levels(scene, part, signal, key):
                yield short(what, signal, law(level), f"{path}.{key}", falls, high, types)

    for name, field in scene.nutrients.items():
        yield from needs(field, name, f"nutrients.{name}")
    if scene.energy is not None:
        yield from needs(scene.energy, "ATP", "energy")
    if scene.growth is not None and scene.growth.critical_pressure is not None:
        key, critical = "growth.critical_pressure", scene.growth.critical_pressure
        yield short("growth rate", "pressure", LinearResponse(0.0, critical), key, falls=True)
        yield short("rest", "pressure", Threshold(critical), key, falls=False)


def _levels(
    scene: Scene, part: Any, signal: str, key: str
) -> Iterator[tuple[float, tuple[str, ...]]]:
    """Yield the levels of a need, each with its types; without types where it is that of all."""
    if f"{key}_of" not in specs(CellType) or signal not in scene.nutrients:
        yield getattr(part, key), ()
        return
    own = type_thresholds(scene, signal, key)
    for level in dict.fromkeys(own.values()):
        same = tuple(name for name in own if own[name] == level)
        yield level, () if len(same) == len(own) else same


def type_thresholds(scene: Scene, field: str, key: str) -> dict[str, float]:
    """Return the threshold of each type, by name, mM; of a scene without types one, named ``""``.

    - ``key``: ``"quiescence"`` or ``"necrosis"``; empty where the field does not have it
    """
    level = getattr(scene.nutrients[field], key)
    if level is None:
        return {}
    factors = {name: getattr(kind, f"{key}_of") or {} for name, kind in scene.types.items()}
    return {name: level * of.get(field, 1.0) for name, of in (factors or {"": {}}).items()}


def usual_type(types: Mapping[str, CellType]) -> str:
    """Return the name of the most numerous type at the start; empty where there are none."""
    return max(types, key=lambda name: types[name].fraction, default="")


def shared_threshold(scene: Scene, field: str, key: str) -> float | None:
    """Return the threshold of a field that all types have in common, mM, or None."""
    levels = set(type_thresholds(scene, field, key).values())
    return levels.pop() if len(levels) == 1 else None


def _effect(scene: Scene, name: str, part: Response) -> Effect:
    """Return the effect of a response; it has been checked."""
    behaviour, _ = behaviour_named(part.behaviour, "behaviour")
    full = part.behaviour if behaviour.of else behaviour.name
    low, high = _ends(scene, behaviour, part, falls=part.falls)
    combine = part.combine or behaviour.combine
    law, key = _law(part), f"responses.{name}"
    _check_values(behaviour, combine, own_value(scene, behaviour), part, (low, high))
    return Effect(full, part.signals, law, part.falls, low, high, part.types, combine, key)


def _check_values(
    behaviour: Behaviour, combine: str, own: float, part: Response, ends: tuple[float, float]
) -> None:
    """Raise ``SceneError`` for a rule that has no meaning, and for cells without stiffness."""
    if combine == "product" and own == 0.0:
        problem = f"is 'product', but the {behaviour.name} is 0 without responses"
        hint = "No factor changes 0: use 'sum', or give the scene a value."
        raise SceneError("combine", problem, hint)
    if behaviour.name != "Young's modulus":
        return
    if combine == "sum":
        hint = "Its values are factors: use 'product'."
        raise SceneError("combine", "is 'sum', which could make Young's modulus 0", hint)
    values = ends if part.points is None else tuple(y for _, y in part.points)
    if min(values) == 0.0:
        key = "points" if part.points else "base" if values[0] == 0.0 else "largest"
        hint = "Cells without stiffness would have no contact force: write a small factor, as 0.01."
        raise SceneError(key, "is 0, must be above 0 for Young's modulus", hint)


def _ends(
    scene: Scene, behaviour: Behaviour, part: Response, *, falls: bool
) -> tuple[float, float]:
    """Return the values of a behaviour at no effect and at the full one."""
    law = RESPONSE_LAWS.get(part.law, ResponseLaw)
    if law.gives_values:
        return 0.0, 1.0
    own, base, largest = own_value(scene, behaviour), part.base, part.largest
    assert not isinstance(base, str)
    assert not isinstance(largest, str)
    if largest is None and behaviour.name == "necrosis rate" and law.jumps:
        return 0.0, math.inf
    # a response that rises from nothing to what the scene gives, such as Monod's
    at_rest = 0.0 if falls or largest is None else own
    low = at_rest if base is None else base
    high = own if largest is None else largest
    if low == high and law.has_signal:
        hint = f"Without responses the {behaviour.name} is {own:g}: give another one."
        raise SceneError("largest", f"is missing, or the same as base ({low:g})", hint)
    return low, high


def _law(part: Response) -> ResponseLaw:
    if part.law in OWN_RESPONSES:
        law = OWN_RESPONSES[part.law]
        made: ResponseLaw = build_part(law, part.parameters or {}, "parameters")
        if law.signals != len(part.signals):
            problem = f"names {len(part.signals)}, but the law takes {law.signals}"
            raise SceneError("signal", problem)
        return made
    return RESPONSE_LAWS[part.law].from_keys(part)


def check_responses(scene: Scene) -> None:
    """Turn responses into base units; raise ``SceneError`` for those that do not fit the scene."""
    for name in scene.nutrients:
        if name in SIGNALS:
            problem = "is the name of another signal"
            raise SceneError(f"nutrients.{name}", problem, "Name it otherwise.")
    made = {}
    for name, part in scene.responses.items():
        with below(f"responses.{name}"):
            made[name] = in_base_units(scene, part)
            _effect(scene, name, made[name])
    object.__setattr__(scene, "responses", Tables(made))
    for name, part in made.items():
        for signal in part.signals:
            check_kinds_have(scene, signal, part.types, f"responses.{name}.signal")
    factor, sticky = largest_factor(scene, SURFACE_ENERGY)
    if sticky:
        check_overlap(scene, factor, sticky)
    rules: dict[str, tuple[str, str]] = {}
    for effect in effects(scene):
        if effect.short:
            continue
        first, rule = rules.setdefault(effect.behaviour, (effect.key, effect.combine))
        if rule != effect.combine:
            problem = f"is {effect.combine!r}, but of {first} it is {rule!r}"
            hint = "All responses of one behaviour combine by one rule."
            raise SceneError(f"{effect.key}.combine", problem, hint)


def response_unit(scene: Scene, part: Response, key: str) -> str:
    """Return the base unit of one of a response's numbers."""
    if key in ("base", "largest"):
        return behaviour_named(part.behaviour, "behaviour")[0].unit
    return signal_unit(part.signals[0], scene.nutrients, "signal")


def in_base_units(scene: Scene, part: Response) -> Response:
    """Return a response in base units."""
    behaviour, of = behaviour_named(part.behaviour, "behaviour")
    _check_behaviour(scene, behaviour, of)
    check_kinds(scene, "cells", part.cells)
    if len(part.signals) > 1 and part.law not in OWN_RESPONSES:
        hint = "Give each a response of its own."
        raise SceneError("signal", "names several, as only laws of the user's own have", hint)
    for signal in part.signals:
        check_signal(scene, signal, "signal")
        if behaviour.of == "field" and signal in (of, *group_of(of, scene.reactions)):
            problem = f"is {signal!r}, which is solved for together with {of}"
            hint = "The law of uptake itself is half_saturation; reactions have laws of their own."
            raise SceneError("signal", problem, hint)
        if behaviour.of == "field" and signal not in (
            *scene.nutrients,
            *network_signals(scene),
            "age",
            "volume",
            "radius",
            "pressure",
        ):
            hint = "Uptake and secretion respond to fields, networks, pressure, age and size."
            raise SceneError("signal", f"is {signal!r}", hint)
    changed: dict[str, Any] = {}
    if len(part.signals) == 1:
        read = signal_reader(scene, part.signals[0])
        for key in ("half", "begin", "end"):
            if (value := getattr(part, key)) is not None:
                changed[key] = read(value, key)
    value_of = reader(behaviour.unit, _bounds(behaviour))
    for key in ("base", "largest"):
        if (value := getattr(part, key)) is not None:
            changed[key] = value_of(value, key)
    if part.points is not None:
        read = signal_reader(scene, part.signals[0])
        points = tuple((read(x, "points"), value_of(y, "points")) for x, y in part.points)
        if not rises(points):
            raise SceneError("points", "must have signals that rise")
        changed["points"] = points
    if part.half is not None and not changed["half"] > 0.0:
        raise SceneError("half", f"is {changed['half']:g}, must be above 0")
    if part.law == "linear" and not changed["begin"] < changed["end"]:
        problem = f"is {changed['end']:g}, must be above begin ({changed['begin']:g})"
        raise SceneError("end", problem, "With falls = true the effect is full below begin.")
    return replace(part, **changed)


def _bounds(behaviour: Behaviour) -> Bounds:
    least = -1.0 if behaviour.name == "bias" else 0.0
    return Bounds(at_least=least, at_most=behaviour.at_most)


def check_signal(scene: Scene, name: str, path: str) -> None:
    """Raise ``SceneError`` for a signal that the scene does not have."""
    signal_unit(name, scene.nutrients, path)
    if "." in name:
        check_network_signal(scene, name, path)
    if name == "ATP" and scene.energy is None:
        raise SceneError(
            path, "is 'ATP', but the scene has no energy", "[energy] says who makes it."
        )
    phase = name.removeprefix(PHASE)
    if name.startswith(PHASE):
        if scene.growth is None or not scene.growth.phases:
            hint = "Give the scene [growth.phases]."
            raise SceneError(path, f"is {name!r}, but the cells have no phases", hint)
        if phase not in Phase.__members__:
            problem = f"is {name!r}, but {phase!r} is no phase"
            raise SceneError(path, problem, near_miss(phase, Phase.__members__))
    kind = name.removeprefix(CONTACTS)
    if name.startswith(CONTACTS) and kind not in scene.types:
        problem = f"is {name!r}, but {kind!r} is no type of this scene"
        raise SceneError(path, problem, near_miss(kind, scene.types))


def signal_reader(scene: Scene, name: str) -> Any:
    """Return a reader of values of a signal; of oxygen also as a pressure or a percentage."""
    read = reader(signal_unit(name, scene.nutrients, "signal"), Bounds())

    def oxygen(value: Any, path: str) -> float:
        given = (
            concentration(value, name, path, scene.nutrients) if isinstance(value, str) else value
        )
        level = float(read(given, path))
        check_dissolves(level, scene.nutrients[name].temperature, path)
        return level

    return oxygen if is_oxygen(name) and name in scene.nutrients else read


def _check_behaviour(scene: Scene, behaviour: Behaviour, of: str) -> None:
    """Raise ``SceneError`` for a behaviour that the scene's cells do not have."""
    known = {
        "field": list(scene.nutrients),
        "type": list(scene.types),
        "phase": [phase.name for phase in Phase][1:],
    }.get(behaviour.of)
    if known is not None and of not in known:
        problem = f"is '{behaviour.name} {of}', but {of!r} is no {behaviour.of} of this scene"
        raise SceneError("behaviour", problem, near_miss(of, known))
    growth, name = scene.growth, behaviour.name
    phases = growth is not None and bool(growth.phases)
    grows = ("growth rate", "rest", "mutation to", "asymmetric division to", "entry into")
    lacking = {
        "[growth]": name in grows and growth is None,
        "[growth.phases]": name == "entry into" and not phases,
        "[motility]": name == "bias" and scene.motility is None,
        "[adhesion]": name in ("receptors", "ligands") and scene.adhesion is None,
    }
    if name == SURFACE_ENERGY and largest_energy(scene) == 0.0:
        problem = f"is {name!r}, which has no effect: the contacts have none"
        hint = "Take a contact law that has one, such as law = 'jkr', above 0."
        raise SceneError("behaviour", problem, hint)
    active = scene.motility is not None or bool(scene.chemotaxis)
    lacking["[motility]"] |= name == "speed" and not active
    for table, missing in lacking.items():
        if missing:
            problem = f"is {name!r}, which has no effect without {table}"
            raise SceneError("behaviour", problem, "Give the scene that table.")
    if name == "uptake of" and not scene.nutrients[of].takes_up:
        raise SceneError("behaviour", f"has no effect: the uptake of {of} is zero")
    made = name == "secretion of" and scene.nutrients[of]
    if made and made.secretion == 0.0 and not made.secretion_from:
        raise SceneError("behaviour", f"has no effect: the secretion of {of} is zero")
