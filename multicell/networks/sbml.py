"""Networks from SBML: the system of equations of a document, as functions.

sbmlode derives the equations (which of species, compartments and parameters are states, in what
quantity, divided by what), from a document that :mod:`multicell.networks.documents` has let pass.
Here it is checked that what comes out is complete, and code is made of it.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from graphlib import CycleError, TopologicalSorter
from typing import Any, Final

import libsbml
import numpy as np
from sbmlode import OdeSystem

from multicell.errors import SceneError
from multicell.networks.documents import check_document
from multicell.networks.equations import Equations
from multicell.networks.expressions import nodes_of
from multicell.networks.generated import functions_of
from multicell.networks.network import Event, Network
from multicell.networks.stated_units import second_of, units_stated

_IDENTIFIER: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,127}")
_MAX_EXPANDED: Final = 100_000  # nodes of a formula with all that libraries put into it
_FORGIVEN: Final = frozenset(
    {libsbml.MissingXMLDecl, libsbml.MissingXMLEncoding, libsbml.BadXMLDecl}
)
"""Errors in the first line of a document, which can be read in spite of them."""


def network_from_sbml(
    text: str, name: str, inputs: Sequence[str] = (), given: Collection[str] = ()
) -> Network:
    """Return the network that a document of SBML describes.

    - ``text``: the document
    - ``name``: of the file, for messages and for the network where the model has no identifier
    - ``inputs``: what is set from outside at each time: parameters, and species, whose reactions
      then do not change them
    - ``given``: parameters that are set before anything is computed, and need no value

    Raises SceneError with the file for what is no SBML, or holds what is not read.
    """
    check_document(text, name)
    try:
        document = _parsed(text)
        model = document.getModel()
        _check_sizes(model)
        _check_references(model)
        system = _system(document)
        units, second = units_stated(model), second_of(model)
        if system.size_rates or "rateOf" in text:
            # formulas hold rates of states, which those that are inputs have no more
            for state in set(inputs) & set(system.states):
                raise SceneError("", f"cannot have '{state}' as an input: rates of change are read")
        return _network(system, model.getId() or name, inputs, given, units, second)
    except RecursionError:
        raise SceneError(name, "has a formula that is nested too deeply") from None
    except SceneError as error:
        raise SceneError(
            name if not error.path else f"{name}: {error.path}", error.problem, error.hint
        ) from None


def _parsed(text: str) -> Any:
    document = libsbml.readSBMLFromString(text)
    for k in range(document.getNumErrors()):
        error = document.getError(k)
        severe = error.getSeverity() >= libsbml.LIBSBML_SEV_ERROR
        if severe and error.getErrorId() not in _FORGIVEN:
            words = " ".join(error.getShortMessage().split())
            raise SceneError(f"line {error.getLine()}", f"is no valid SBML: {words}")
    if document.getModel() is None:
        raise SceneError("", "has no model")
    return document


def _system(document: Any) -> Any:
    try:
        system = OdeSystem.from_sbml(document)
    except (ValueError, NotImplementedError) as error:
        words = " ".join(str(error).split())[:300].rstrip(".")
        raise SceneError("", f"is no system of equations: {words}") from None
    if system.unsupported:
        found = ", ".join(f"{what} ('{who[:80]}')" for what, who in system.unsupported[:5])
        raise SceneError("", f"has what is not read here: {found}")
    return system


def _check_sizes(model: Any) -> None:
    """Refuse identifiers that are none, circles, and formulas that grow where they are expanded."""
    for element in model.getListOfAllElements():
        name = element.getIdAttribute()
        if name and not _IDENTIFIER.fullmatch(name):
            raise SceneError("", f"has {name[:60]!r}, which is no identifier")
    if (model.getLevel(), model.getVersion()) < (3, 2):  # from then on no formula means no effect
        _check_formulas(model)
    definitions = {f.getId(): f.getBody() for f in model.getListOfFunctionDefinitions()}
    calls = _grown({name: nodes_of(body) for name, body in definitions.items() if body}, _called)
    rules = {r.getVariable(): r for r in model.getListOfRules() if r.isSetMath()}
    moving = {name: nodes_of(r.getMath()) for name, r in rules.items() if r.isRate()}
    _grown(moving, _asked_rate, calls)
    named = {name: nodes_of(r.getMath()) for name, r in rules.items() if not r.isRate()}
    named |= {r.getId(): _law(r) for r in model.getListOfReactions()}
    sizes = _grown(named, _named, calls, most=math.inf)
    for one in model.getListOfCompartments():  # sbmlode differentiates their rules along all paths
        if sizes.get(one.getId(), 0.0) > _MAX_EXPANDED:
            raise _too_large(one.getId())


def _check_references(model: Any) -> None:
    """Refuse names that stand for two things, or for none: libraries leave out what they miss."""
    reactions = list(model.getListOfReactions())
    sides = [(*r.getListOfReactants(), *r.getListOfProducts()) for r in reactions]
    counted = [one for side in sides for one in side]
    sized = (*model.getListOfCompartments(), *model.getListOfSpecies())
    quantities = [*sized, *model.getListOfParameters(), *(one for one in counted if one.getId())]
    others = (*reactions, *model.getListOfFunctionDefinitions(), *model.getListOfEvents())
    names = Counter(one.getId() for one in (*quantities, *others) if one.getId())
    twice = next((name for name, count in names.items() if count > 1), None)
    if twice is not None:
        raise SceneError("", f"has two things called '{twice[:80]}'")
    species = {one.getId() for one in model.getListOfSpecies()}
    compartments = {one.getId() for one in model.getListOfCompartments()}
    # Level 1 calls nothing constant
    fixed = {one.getId() for one in quantities if model.getLevel() > 1 and one.getConstant()}
    known = {one.getId() for one in quantities}
    rules = {r.getVariable() for r in model.getListOfRules()}
    first = {one.getSymbol() for one in model.getListOfInitialAssignments()}
    used = {one.getSpecies() for one in counted}
    used |= {one.getSpecies() for r in reactions for one in r.getListOfModifiers()}
    places = {one.getCompartment() for one in model.getListOfSpecies()} - {""}
    wanted = ((rules | first, known), (used, species), (places, compartments))
    for needed, there in wanted:
        for name in sorted(needed - there):
            raise SceneError("", f"names '{name[:80]}', which it does not define")
    for name in sorted(rules & fixed):
        raise SceneError("", f"has a rule for '{name[:80]}', which it calls constant")


def _check_formulas(model: Any) -> None:
    """Refuse rules and laws whose formula is absent, or could not be read."""
    laws = [r.getKineticLaw() for r in model.getListOfReactions() if r.getKineticLaw()]
    for one in (*model.getListOfRules(), *model.getListOfInitialAssignments(), *laws):
        if not one.isSetMath():
            line = f"line {one.getLine()}"
            raise SceneError(line, f"'{one.getElementName()}' has no formula that can be read")


def _law(reaction: Any) -> list[Any]:
    """Return the nodes of a kinetic law without names of its own parameters."""
    law = reaction.getKineticLaw()
    if law is None or not law.isSetMath():
        return []
    own = {one.getId() for one in (*law.getListOfParameters(), *law.getListOfLocalParameters())}
    return [node for node in nodes_of(law.getMath()) if _named(node) not in own]


def _called(node: Any) -> Any:
    return node.getName() if node.getType() == libsbml.AST_FUNCTION else None


def _named(node: Any) -> str | None:
    return node.getName() if node.getType() == libsbml.AST_NAME else None


def _asked_rate(node: Any) -> str | None:
    is_rate = node.getType() == libsbml.AST_FUNCTION_RATE_OF and node.getNumChildren() == 1
    return node.getChild(0).getName() if is_rate else None


def _grown(
    trees: Mapping[str, list[Any]],
    leads_to: Callable[[Any], str | None],
    calls: Mapping[str, float] | None = None,
    most: float = _MAX_EXPANDED,
) -> dict[str, float]:
    """Return how many nodes formulas have with others put into them where they name these.

    - ``trees``: name -> its nodes
    - ``leads_to``: returns the name of the formula that takes a node's place, if one does
    - ``calls``: sizes of functions that they call
    """
    follow: dict[str, list[str]] = {}
    own: dict[str, float] = {}
    for name, nodes in trees.items():
        own[name] = len(nodes) + sum((calls or {}).get(one, 0.0) for one in map(_called, nodes))
        follow[name] = [one for one in map(leads_to, nodes) if one is not None and one in trees]
    sizes: dict[str, float] = {}
    try:
        order = list(TopologicalSorter(follow).static_order())
    except CycleError as error:
        circle = ", ".join(f"'{name[:40]}'" for name in error.args[1][:5])
        raise SceneError("", f"has formulas that need each other in a circle: {circle}") from None
    for name in order:
        sizes[name] = own[name] + sum(sizes[one] for one in follow[name])
        if sizes[name] > most:
            raise _too_large(name)
    return sizes


def _too_large(name: str) -> SceneError:
    problem = f"has a formula of more than {_MAX_EXPANDED:,} parts once expanded ('{name[:80]}')"
    return SceneError("", problem)


def _network(
    system: Any,
    name: str,
    inputs: Sequence[str],
    given: Collection[str],
    units: Mapping[str, str],
    second: float | None,
) -> Network:
    whole = _numbers(Equations(system, ()))[1]
    plan = Equations(system, inputs)
    text, numbers, functions = _numbers(plan, whole)
    for one in sorted(plan.used - set(given)):
        if math.isnan(numbers[one]):
            raise SceneError("", f"has no value for '{one}'")
    for one in plan.states:
        if not math.isfinite(numbers[one]):
            raise SceneError("", f"begins with '{one}' at {numbers[one]:g}, must be finite")
    known = (*plan.states, *plan.inputs, *plan.parameters, *plan.observed)
    sizes = {q.symbol.sid for q in system.compartments}  # which halve with the cell, as amounts do
    amounts = sizes | {q.symbol.sid for q in system.species if q.amount}
    return Network(
        name=name,
        states=plan.states,
        start=tuple(numbers[one] for one in plan.states),
        inputs=plan.inputs,
        defaults=tuple(numbers[one] for one in plan.inputs),
        parameters=plan.parameters,
        values=tuple(numbers[one] for one in plan.parameters),
        observed=plan.observed,
        rates=functions["rates"],
        observe=functions.get("observe"),
        source=text,
        events=tuple(_events(plan, functions)),
        units={one: units[one] for one in known if one in units},
        amounts=frozenset(amounts & set(plan.states)),
        time_unit=second,
        initial=functions["initial"],
        computed=frozenset(plan.computed),
    )


def _numbers(
    plan: Equations, known: Mapping[str, float] | None = None
) -> tuple[str, dict[str, float], Mapping[str, Any]]:
    """Return the code, the value of each quantity at the start, and the functions.

    - ``known``: values of the inputs
    """
    text = plan.text()
    try:
        functions = functions_of(text)
    except (ValueError, SyntaxError) as error:
        raise SceneError("", f"gives code that is not run: {str(error)[:200]}") from None
    stated = {q.symbol.sid: q.value for q in plan.system.quantities if q.value is not None}
    y = np.full(len(plan.states), np.nan)
    p = np.array([stated.get(name, np.nan) for name in plan.parameters], dtype=float)
    u = np.array([(known or stated).get(name, np.nan) for name in plan.inputs], dtype=float)
    try:
        with np.errstate(all="ignore"):
            functions["initial"](u, p, y)
    except (ArithmeticError, ValueError, TypeError) as error:
        raise SceneError("", f"has no values at the start: {error}") from None
    names = (*plan.states, *plan.parameters, *plan.inputs)
    return text, dict(zip(names, map(float, (*y, *p, *u)), strict=True)), functions


def _events(plan: Equations, functions: Mapping[str, Any]) -> Iterable[Event]:
    for k, event in enumerate(plan.events):
        yield Event(
            name=event.symbol.sid,
            trigger=functions[f"trigger{k}"],
            assign=functions[f"assign{k}"],
            persistent=event.persistent,
            initial=event.initial_value,
        )
