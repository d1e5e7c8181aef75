"""Documents of SBML for tests, from formulas as they are written by hand."""

from collections.abc import Mapping

import libsbml


def math(formula: str) -> str:
    """Return a formula as MathML; one that begins with '<' is that already."""
    if formula.startswith("<"):
        return f'<math xmlns="http://www.w3.org/1998/Math/MathML">{formula}</math>'
    tree = libsbml.parseL3Formula(formula)
    assert tree is not None, libsbml.getLastParseL3Error()
    return libsbml.writeMathMLToString(tree).split("?>", 1)[1]


def function(name: str, arguments: str, body: str) -> str:
    return (
        f'<functionDefinition id="{name}">{math(f"lambda({arguments}, {body})")}'
        "</functionDefinition>"
    )


def reaction(name: str, before: str, after: str, law: str, *, fast: str = "") -> str:
    """Return a reaction; ``before``, ``after``: "A 2B" for A and two of B."""
    sides = [
        "".join(
            f'<speciesReference species="{one.lstrip("0123456789.")}" constant="true" '
            f'stoichiometry="{one[: len(one) - len(one.lstrip("0123456789."))] or 1}"/>'
            for one in side.split()
        )
        for side in (before, after)
    ]
    lists = [
        f"<listOf{what}>{side}</listOf{what}>" if side else ""
        for what, side in zip(("Reactants", "Products"), sides, strict=True)
    ]
    return (
        f'<reaction id="{name}" reversible="false"{fast}>{"".join(lists)}'
        f"<kineticLaw>{math(law)}</kineticLaw></reaction>"
    )


def event(name: str, trigger: str, changes: Mapping[str, str], more: str = "", **about) -> str:
    """Return an event.

    - ``about``: ``initial``, ``persistent``, ``then`` (whether values are those of the trigger)
    """
    flags = [about.get(key, True) for key in ("initial", "persistent", "then")]
    initial, persistent, then = (str(flag).lower() for flag in flags)
    assigned = "".join(
        f'<eventAssignment variable="{one}">{math(value)}</eventAssignment>'
        for one, value in changes.items()
    )
    return (
        f'<event id="{name}" useValuesFromTriggerTime="{then}">'
        f'<trigger initialValue="{initial}" persistent="{persistent}">{math(trigger)}</trigger>'
        f"{more}<listOfEventAssignments>{assigned}</listOfEventAssignments></event>"
    )


def document(
    *,
    species: Mapping[str, str] | None = None,
    parameters: Mapping[str, str] | None = None,
    sizes: Mapping[str, str] | None = None,
    rates: Mapping[str, str] | None = None,
    assigned: Mapping[str, str] | None = None,
    initial: Mapping[str, str] | None = None,
    reactions: str = "",
    functions: str = "",
    events: str = "",
    units: str = "",
    model: str = "",
    root: str = "",
    rules: str = "",
) -> str:
    """Return a document of Level 3 Version 2.

    - ``species``, ``parameters``, ``sizes``: name -> value, or attributes that hold one
    - ``rates``, ``assigned``, ``initial``: name -> formula
    """
    ruled = {*(rates or {}), *(assigned or {})}

    def stated(value: str, usual: str) -> str:
        return value if "=" in value else f'{usual}="{value}"'

    def constant(name: str) -> str:
        return str(name not in ruled and f'"{name}"' not in events).lower()

    parts = {
        "FunctionDefinitions": functions,
        "UnitDefinitions": units,
        "Compartments": "".join(
            f'<compartment id="{name}" {stated(value, "size")} spatialDimensions="3" '
            f'constant="{constant(name)}"/>'
            for name, value in (sizes or ({"cell": "1"} if species else {})).items()
        ),
        "Species": "".join(
            f'<species id="{name}" {stated(value, "initialConcentration")} constant="false"'
            + ("" if "compartment=" in value else ' compartment="cell"')
            + ("" if "hasOnly" in value else ' hasOnlySubstanceUnits="false"')
            + ("" if "boundary" in value else ' boundaryCondition="false"')
            + "/>"
            for name, value in (species or {}).items()
        ),
        "Parameters": "".join(
            f'<parameter id="{name}" {stated(value, "value")} constant="{constant(name)}"/>'
            for name, value in (parameters or {}).items()
        ),
        "InitialAssignments": "".join(
            f'<initialAssignment symbol="{name}">{math(formula)}</initialAssignment>'
            for name, formula in (initial or {}).items()
        ),
        "Rules": rules
        + "".join(
            f'<assignmentRule variable="{name}">{math(formula)}</assignmentRule>'
            for name, formula in (assigned or {}).items()
        )
        + "".join(
            f'<rateRule variable="{name}">{math(formula)}</rateRule>'
            for name, formula in (rates or {}).items()
        ),
        "Reactions": reactions,
        "Events": events,
    }
    lists = "".join(f"<listOf{key}>{text}</listOf{key}>" for key, text in parts.items() if text)
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        '<sbml xmlns="http://www.sbml.org/sbml/level3/version2/core" level="3" version="2"'
        f'{root}><model id="own"{model}>{lists}</model></sbml>'
    )
