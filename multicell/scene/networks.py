"""Networks inside the cells of a scene, and whether they fit the rest of it.

Species, parameters and rules of a network are signals: ``NETWORK.NAME``; in the neighbours that
touch a cell they are ``neighbours.NETWORK.NAME`` (their mean) and ``sum of
neighbours.NETWORK.NAME``; with ``weighted`` before it each counts by the area of its contact.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final

from multicell.behaviours.catalogue import OF_NEIGHBOURS, SUM_OF, WEIGHTED, value_around
from multicell.errors import SceneError
from multicell.host.files import other_file
from multicell.scene.checks import check_kinds, check_names
from multicell.schema import (
    Draw,
    below,
    choice,
    drawn_numbers,
    flag,
    near_miss,
    number,
    parameters,
    quantities,
    quantity,
    separated,
    text,
    texts,
)
from multicell.units import to_base

if TYPE_CHECKING:
    from multicell.networks.network import Network
    from multicell.scene.scene import Scene

DIVIDE: Final = ("keep", "halve", "binomial", "share", "reset")
"""What daughters get of a state: all of it, half, as many as chance gives each molecule, a part
that is drawn, or its value at the start. Of a concentration a part of one half is all of it."""
METHODS: Final = ("auto", "rodas3", "rodas4", "dormand-prince", "rk4", "euler")
FIXED: Final = ("rk4", "euler")
EXCHANGES: Final = ("uptake", "secretion")


@final
@parameters
class CellNetwork:
    """A network of reactions inside each cell of some types."""

    file: str | None = text(
        default=None, doc="SBML or Antimony file; relative paths count from the folder of the scene"
    )
    sha256: str | None = text(default=None, doc="digest of the file; absent: that which it has")
    network: str | None = text(
        default=None, doc="one of the user's own, 'file.py:name', in place of a file"
    )
    cells: str | None = text(default=None, doc="types, separated by commas; absent: all cells")
    inputs: Mapping[str, str] | None = texts(doc="input of the network -> signal of the cell")
    start: str = choice(["given", "steady"], default="given", doc="as stated, or at rest")
    units: Mapping[str, str] | None = texts(doc="of quantities whose unit the network leaves open")
    scales: Mapping[str, float] | None = quantities(
        "",
        above=0,
        doc="input -> how many of its unit one base unit of the signal is, in place "
        "of what the units say",
    )
    time_unit: float | None = quantity(
        "s", default=None, above=0, doc="of the network's time, where it states none; absent: 1 s"
    )
    parameters: Mapping[str, float | Draw] | None = drawn_numbers(
        doc="in place of the network's own, in its unit: a value, or a draw for each cell"
    )
    fluxes: Mapping[str, str] | None = texts(
        doc="field -> 'uptake: NAME' or 'secretion: NAME', a rate of the network"
    )
    divide: Mapping[str, str] | None = texts(
        doc=f"state -> {', '.join(DIVIDE)}; absent: amounts halve, concentrations are kept"
    )
    dilution: bool = flag(default=True, doc="whether concentrations fall as the cell grows")
    method: str = choice(METHODS, default="auto", doc="by which it is solved")
    tolerance: float = number(
        default=1e-4, at_least=1e-12, at_most=0.1, doc="relative, of the error of one step"
    )
    absolute_tolerance: float | None = number(
        default=None, above=0, doc="in the network's unit; absent: follows from the start"
    )
    step: float | None = quantity(
        "s", default=None, above=0, doc="length of all steps, without error control"
    )

    def prepare(self) -> None:
        """Take a network itself in the place of its name."""
        name = getattr(self.network, "name", None)
        if name is not None:
            object.__setattr__(self, "network", name)
        if isinstance(self.file, os.PathLike):
            object.__setattr__(self, "file", os.fspath(self.file))

    def check(self) -> None:
        """Raise ``SceneError`` where it is not stated what network it is."""
        if (self.file is None) == (self.network is None):
            problem = "is missing" if self.file is None else "and network are both given"
            raise SceneError("file", problem, "Give a file, or a network of your own.")
        if self.method in FIXED and self.step is None:
            raise SceneError("step", f"is missing: the method is {self.method!r}")
        if self.file is not None:
            path = os.path.abspath(os.path.expanduser(self.file))
            object.__setattr__(self, "file", path)
            digest = _digest(_text(path))
            if self.sha256 not in (None, digest):
                raise other_file(path)
            object.__setattr__(self, "sha256", digest)

    @property
    def types(self) -> tuple[str, ...]:
        """The types whose cells have it; empty for all."""
        return separated(self.cells)

    @property
    def model(self) -> Network:
        """The network itself; a file is read once."""
        if self.network is not None:
            from multicell.networks.custom import OWN_NETWORKS

            if self.network not in OWN_NETWORKS:
                problem = f"is {self.network!r}, which is no network here"
                raise SceneError("network", problem, OWN_NETWORKS.hint(self.network))
            found: Any = OWN_NETWORKS[self.network]
            return found  # type: ignore[no-any-return]
        return _read(self.document, tuple(self.inputs or ()), tuple(self.parameters or ()))

    @property
    def document(self) -> _Document:
        """The file of a network that has one."""
        assert self.file is not None
        assert self.sha256 is not None
        return _Document(self.file, Path(self.file).suffix.lower(), self.sha256)

    def content(self) -> bytes:
        """Return the text of the file; raises ``SceneError`` where its digest is another one."""
        return self.document.text().encode()

    def seconds(self) -> float:
        """Return the unit of the network's time, s."""
        return self.model.time_unit or self.time_unit or 1.0

    def unit_of(self, name: str) -> str:
        """Return the unit of a state, input, parameter or observed value; empty: none is known."""
        return self.model.units.get(name) or (self.units or {}).get(name, "")


@final
@dataclass(frozen=True)
class _Document:
    """A file of a network; wherever it is, it is the same with the same content."""

    path: str = field(compare=False)
    suffix: str
    digest: str

    def text(self) -> str:
        """Return its text; raises ``SceneError`` for a file with another digest."""
        text = _text(self.path)
        if _digest(text) != self.digest:
            raise other_file(self.path)
        return text


@lru_cache(maxsize=32)
def _read(document: _Document, inputs: tuple[str, ...], given: tuple[str, ...]) -> Network:
    """Return the network of a file, known by its digest."""
    from multicell.networks.files import network_of_text

    try:
        return network_of_text(document.text(), document.path, inputs, given)
    except SceneError as error:
        where = f"{error.path}: " if error.path else ""
        raise SceneError("file", f"{where}{error.problem}", error.hint) from None


def _text(path: str) -> str:
    from multicell.networks.documents import read_network_document

    try:
        return read_network_document(Path(path))
    except SceneError as error:
        raise SceneError("file", error.problem, error.hint) from None


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


HIDDEN: Final = "~"
"""In the names of columns of ``Cells.inside`` that are no values of a network."""


def columns_of_network(scene: Scene, name: str) -> tuple[str, ...]:
    """Return the names of the columns of ``Cells.inside`` that a network has.

    First its states, then parameters where events may change them; hidden ones are its inputs at
    the end of the last step, and what the solver remembers. Where networks change fields, also what
    is needed to extrapolate: slopes of the inputs, the uptake of each of its fields over the
    largest one, and slopes of that.
    """
    part, model = scene.networks[name], scene.networks[name].model
    own = [*model.states, *(model.parameters if model.events else ())]
    hidden = [f"input {x}" for x in model.inputs]
    hidden += ["step", "kind", "evidence", *(f"event {event.name}" for event in model.events)]
    if networks_change_fields(scene):
        hidden += [f"slope of {x}" for x in model.inputs]
        hidden += [f"share of {x}" for x in part.fluxes or ()]
        hidden += [f"slope of share of {x}" for x in part.fluxes or ()]
    return tuple(f"{name}.{x}" for x in (*own, *(f"{HIDDEN}{x}" for x in hidden)))


def networks_change_fields(scene: Scene) -> bool:
    """Return whether fields hang on networks: by fluxes, or by responses of uptake or secretion."""
    if any(part.fluxes for part in scene.networks.values()):
        return True
    exchanges = tuple(f"{what} of " for what in EXCHANGES)
    return bool(scene.networks) and any(
        response.behaviour.startswith(exchanges) and any("." in name for name in response.signals)
        for response in scene.responses.values()
    )


def network_columns(scene: Scene) -> tuple[str, ...]:
    """Return the names of all columns of ``Cells.inside`` of a scene."""
    order = network_order(scene)
    return tuple(x for name in order for x in columns_of_network(scene, name))


def network_states(scene: Scene) -> dict[str, int]:
    """Return the place of each state among the columns, by ``NETWORK_STATE``."""
    found, columns = {}, network_columns(scene)
    for name, part in scene.networks.items():
        for state in part.model.states:
            found[f"{name}_{state}"] = columns.index(f"{name}.{state}")
    return found


def network_signals(scene: Scene) -> Iterator[str]:
    """Yield the signals that networks make, without those of neighbours."""
    for name, part in scene.networks.items():
        model = part.model
        for of in (*model.states, *model.observed, *model.parameters, *model.inputs):
            yield f"{name}.{of}"


def check_network_signal(scene: Scene, name: str, path: str) -> None:
    """Raise ``SceneError`` for the signal of a network that the scene does not have."""
    known = list(network_signals(scene))
    bare = value_around(name)
    alone = name.startswith((SUM_OF, WEIGHTED)) and OF_NEIGHBOURS not in name
    if alone or bare not in known:
        near = get_close_matches(bare, known, 1, 0.6)
        hint = f"Did you mean '{near[0]}'?" if near else near_miss(bare, known)
        raise SceneError(path, f"is {name!r}, which is no signal here", hint)


def check_kinds_have(scene: Scene, signal: str, kinds: Collection[str], path: str) -> None:
    """Raise ``SceneError`` where cells are to find what a network in them makes, and some lack it.

    - ``kinds``: types of the cells; empty for all
    """
    network, dot, _ = signal.partition(".")
    if not dot or network not in scene.networks or not scene.networks[network].types:
        return
    having = scene.networks[network].types
    lacking = [kind for kind in kinds or scene.types if kind not in having]
    if lacking:
        problem = f"is {signal!r}, but cells of type {lacking[0]!r} have no network {network!r}"
        raise SceneError(path, problem, f"Only these have it: cells = {', '.join(having)!r}.")


def check_networks(scene: Scene, check_signal: Callable[[Scene, str, str], None]) -> None:
    """Raise ``SceneError`` for networks that do not fit to the scene.

    - ``check_signal``: refuses what is no signal of the scene, with its path
    """
    # all are read before any is checked: a signal of one may be a value of another
    for check in (lambda part: part.model, lambda part: _check_one(scene, part, check_signal)):
        for name, part in scene.networks.items():
            with below(f"networks.{name}"):
                check(part)
    network_order(scene)


def _check_one(
    scene: Scene, part: CellNetwork, check_signal: Callable[[Scene, str, str], None]
) -> None:
    model = part.model
    check_kinds(scene, "cells", part.cells)
    check_names(part.inputs, model.inputs, "inputs", "an input of the network")
    check_names(part.scales, model.inputs, "scales", "an input of the network")
    check_names(part.parameters, model.parameters, "parameters", "a parameter of the network")
    everything = [*model.states, *model.inputs, *model.parameters, *model.observed]
    check_names(part.units, everything, "units", "of the network")
    check_names(part.divide, model.states, "divide", "a state of the network")
    check_names(part.fluxes, scene.nutrients, "fluxes", "a field of this scene")
    for of, unit in (part.units or {}).items():
        stated = model.units.get(of)
        if stated not in (None, "", unit):
            problem = f"is {unit!r}, but the network states {stated!r}"
            raise SceneError(f"units.{of}", problem, "Leave it out.")
    if part.time_unit is not None and model.time_unit not in (None, part.time_unit):
        raise SceneError(
            "time_unit",
            f"is {part.time_unit:g} s, but the network states {model.time_unit:g} s",
            "Leave it out.",
        )
    for name, signal in (part.inputs or {}).items():
        check_signal(scene, signal, f"inputs.{name}")
        check_kinds_have(scene, signal, part.types, f"inputs.{name}")
        input_factor(scene, part, name)
    for name, rule in (part.divide or {}).items():
        if rule not in DIVIDE:
            raise SceneError(f"divide.{name}", f"is {rule!r}", near_miss(rule, DIVIDE))
        if rule == "binomial" and name not in model.amounts:
            problem = "is 'binomial', but it is a concentration, whose molecules are not counted"
            raise SceneError(f"divide.{name}", problem)
    for target in part.fluxes or {}:
        flux_factor(part, target)
        what = flux_of(part, target)[0]
        for name, response in scene.responses.items():
            if response.behaviour == f"{what} of {target}":
                problem = f"replaces the {what} that responses.{name} changes"
                raise SceneError(f"fluxes.{target}", problem, "Leave one of the two out.")


def flux_of(part: CellNetwork, field: str) -> tuple[str, str]:
    """Return ``"uptake"`` or ``"secretion"``, and the name of the rate in the network."""
    assert part.fluxes is not None
    what, _, name = (word.strip() for word in part.fluxes[field].partition(":"))
    path, model = f"fluxes.{field}", part.model
    if what not in EXCHANGES or not name:
        problem = f"is {part.fluxes[field]!r}, must be 'uptake: NAME' or 'secretion: NAME'"
        raise SceneError(path, problem)
    known = [*model.observed, *model.states, *model.parameters]
    if name not in known:
        problem = f"names {name!r}, which is nothing of the network"
        raise SceneError(path, problem, near_miss(name, known))
    return what, name


def flux_factor(part: CellNetwork, field: str) -> float:
    """Return the factor that brings a rate of the network to amol/s.

    One without a unit is in amol over the network's own unit of time.
    """
    name = flux_of(part, field)[1]
    unit = part.unit_of(name)
    if not unit:
        return 1.0 / part.seconds()
    try:
        return to_base(f"1 {unit}", "amol/s", f"fluxes.{field}")
    except SceneError as error:
        problem = f"is {name!r} in {unit}, but must be an amount per time"
        raise SceneError(f"fluxes.{field}", problem, error.hint) from None


def input_factor(scene: Scene, part: CellNetwork, name: str) -> float:
    """Return the factor that brings a signal in base units to the unit of an input."""
    from multicell.behaviours.catalogue import signal_unit

    if name in (part.scales or {}):
        assert part.scales is not None
        return part.scales[name]
    unit = part.unit_of(name)
    assert part.inputs is not None
    base = signal_unit(part.inputs[name], scene.nutrients, f"inputs.{name}")
    if not unit or not base or unit == "dimensionless":
        return 1.0
    try:
        return 1.0 / to_base(f"1 {unit}", base, f"inputs.{name}")
    except SceneError as error:
        problem = f"is {part.inputs[name]!r} in {base}, but the network has {name} in {unit}"
        hint = f"Where that is meant, scales.{name} says how many {unit} one {base} is."
        raise SceneError(f"inputs.{name}", problem, hint) from error


def network_order(scene: Scene) -> list[str]:
    """Return the networks, each after those whose values in the same cell it takes."""
    order: list[str] = []
    left = list(scene.networks)
    while left:
        ready = [name for name in left if not _taken(scene, name) & set(left) - {name}]
        own = [name for name in ready if name not in _taken(scene, name)]
        if not own:
            problem = f"take values of each other in a circle: {', '.join(left)}"
            raise SceneError("networks", problem, "Make one network of them.")
        order += own
        left = [name for name in left if name not in own]
    return order


def _taken(scene: Scene, name: str) -> set[str]:
    """Return the networks whose values in the same cell a network takes."""
    signals = (scene.networks[name].inputs or {}).values()
    return {x.partition(".")[0] for x in signals if "." in x and OF_NEIGHBOURS not in x}
