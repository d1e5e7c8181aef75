"""Networks inside cells: what libRoadRunner solves in PhysiCell.

``intracellular`` of the type ``roadrunner`` names a file of SBML and maps between it and the cell:
substances set species, and species set behaviours of the cell, by a code. Numbers pass as they are,
whatever units the file states: a substance in its unit, rates per minute, speeds in µm/min. Here a
species acts as a straight line up to the largest value that it begins with or that an event gives
it; beyond that it acts no more.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from multicell.errors import SceneError
from multicell.importing.files import Element, found_file
from multicell.importing.imported import Fate
from multicell.importing.physicell.model import MINUTE, CellDefinition, Model
from multicell.importing.physicell.rules import Rule

if TYPE_CHECKING:
    from pathlib import Path

    from multicell.networks.network import Network

_READ: Final = ("roadrunner", "sbml")
_NAMES: Final = {
    "maboss": "a Boolean network (MaBoSS)",
    "dfba": "flux balance analysis (dFBA)",
    "fba": "flux balance analysis (FBA)",
}
_CODES: Final = (
    (r"da", "apoptosis"),
    (r"dn", "necrosis"),
    (r"mms", "migration speed"),
    (r"mmb", "migration bias"),
    (r"ctr_0_\d+", "cycle entry"),
    (r"ctr_(\d+)_\d+", r"exit from cycle phase \1"),
    (r"sur_(.+)", r"\1 uptake"),
    (r"ssr_(.+)", r"\1 secretion"),
    (r"ssd_(.+)", r"\1 secretion target"),
    (r"ser_(.+)", r"\1 export"),
)
"""What codes of a phenotype stand for, as rules name it."""
_REFUSED: Final = {
    "mpt": "for how long a cell keeps its direction does not hang on signals here",
    "vtsc": "a cell has one volume here, without a solid part of the cytoplasm",
    "vtsn": "a cell has one volume here, without a nucleus",
    "vff": "a cell has one volume here, without a part of fluid",
}
"""Codes of PhysiCell's that have no counterpart -> why; any other is none of its codes."""
_SECOND: Final = "PhysiCell 1.14 sets the uptake of its second substance, whichever is named"
_FOLLOWS: Final = (
    "finds what is around the cell; nothing that the network makes of it is given back"
)


def read_inside(model: Model, folder: Path) -> None:
    """Read ``intracellular`` of all types; to be called with the rules, when fields are known."""
    for kind in model.kinds:
        found = kind.given("intracellular")
        if found is None or found.is_off():
            continue
        sort = found.attributes.get("type", "")
        if sort.lower() in _READ:
            _read_network(model, kind, found, folder)
        elif kind.own("intracellular") is found:
            name = _NAMES.get(sort.lower(), f"a model of the type '{sort[:40]}'")
            note = f"{name}: only networks with rates (roadrunner) are read"
            model.account.take_all([found], Fate.LEFT_OUT, note=note)


def _read_network(model: Model, kind: CellDefinition, found: Element, folder: Path) -> None:
    from multicell.networks.files import read_network

    named = found.find("sbml_filename")
    if named is None:
        raise found.error("names no file", "It has an element 'sbml_filename'.")
    path = found_file(found, folder, "sbml_filename")
    maps = found.all("map")
    inputs = _inputs(model, maps)
    try:
        network = read_network(path, list(inputs))
    except SceneError as error:
        where = f"{error.path}: " if error.path else ""
        raise named.error(f"is {where}{error.problem}", error.hint) from None
    key = f"{kind.key}_network"
    table = model.part("networks", key)
    table["file"] = str(path)
    if len(model.kinds) > 1:
        table["cells"] = kind.key
    if network.time_unit is None:
        table["time_unit"] = MINUTE  # as PhysiCell calls it
    if inputs:
        table["inputs"] = {name: model.fields[substance] for name, substance in inputs.items()}
        table["scales"] = {name: 1.0 / model.unit[of] for name, of in inputs.items()}
    table["dilution"] = False
    if kind.own("intracellular") is found:
        model.account.take(named, Fate.MAPPED, f"networks.{key}")
    for one in maps:
        _read_map(model, kind, one, network, key)


def _inputs(model: Model, maps: list[Element]) -> dict[str, str]:
    """Return the substance that each species takes its value from."""
    found = {}
    for one in maps:
        substance = one.attributes.get("PC_substrate", "")
        if substance:
            if substance not in model.fields:
                raise one.error(f"is of '{substance[:60]}', which is no substance")
            found[one.attributes.get("sbml_species", "")] = substance
    return found


def _read_map(model: Model, kind: CellDefinition, one: Element, network: Network, key: str) -> None:
    species, code = (one.attributes.get(name, "") for name in ("sbml_species", "PC_phenotype"))
    known = (*network.inputs, *network.states, *network.parameters, *network.observed)
    if species not in known:
        raise one.error(f"maps '{species[:60]}', which the network does not have")
    own = kind.own("intracellular") is one.above
    if not code:
        if own and one.attributes.get("PC_substrate"):
            path = f"networks.{key}.inputs.{species}"
            model.account.take(one, Fate.APPROXIMATED, path, _FOLLOWS, species)
        elif own:
            note = "read by C++ code of the model only"
            model.account.take(one, Fate.LEFT_OUT, "", note, species)
        return
    behaviour = next((m.expand(to) for at, to in _CODES if (m := re.fullmatch(at, code))), "")
    top = _largest(network, species)
    if not behaviour or not top > 0.0:
        why = _REFUSED.get(code, "it is none of PhysiCell's")
        note = f"the code '{code[:40]}' has no counterpart here: {why}"
        if behaviour:
            note = "the largest value that it can have is not known"
        if own:
            model.account.take(one, Fate.LEFT_OUT, "", note, f"{species}: {code}")
        return
    text = f"{species}: {code}" if own else ""  # of a parent it has an entry already
    note = f"in proportion up to {top:g}"
    if code.startswith("sur_") and code.removeprefix("sur_") not in list(model.fields)[1:2]:
        note += f"; {_SECOND}"
    signal = f"{key}.{species}"
    model.rules.append(
        Rule(one.path, text, kind, signal, behaviour, top, top, 1.0, note, element=one)
    )


def _largest(network: Network, species: str) -> float:
    """Return the largest value of a species at the start and after each event from there."""
    states: list[tuple[Any, Any]] = [(np.array(network.start), np.array(network.values))]
    u = np.array(network.defaults)
    for event in network.events:
        y, p = (part.copy() for part in states[0])
        event.assign(np.float64(0.0), y, u, p, *states[0])
        states.append((y, p))
    if species in network.states:
        place = network.states.index(species)
        return float(max(y[place] for y, _ in states))
    if species in network.parameters:
        place = network.parameters.index(species)
        return float(max(p[place] for _, p in states))
    return 0.0
