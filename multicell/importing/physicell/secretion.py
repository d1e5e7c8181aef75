"""Uptake and secretion of cells.

A cell of volume V changes the amount of a substance around it by V [S (T - c) - U c] + E: S, T and
U are rate and target of secretion and the rate of uptake, E the net export. Here uptake saturates
(Michaelis–Menten), u V c / (K + c): with K a thousand times the largest concentration it is
(S + U) V c up to a thousandth.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, final

from multicell.importing.account import Fate
from multicell.importing.physicell.model import MINUTE, Kind, Model

if TYPE_CHECKING:
    from multicell.importing.xml import Element

_FAR = 1e3
"""Half saturation over the largest concentration."""
_MAX_HALF = 1e5
"""Largest half saturation of a scene, mM."""


@final
@dataclass(frozen=True)
class Exchange:
    """Exchange of a substance by a type: per minute, in the substance's own unit."""

    secretion: float
    target: float
    uptake: float
    export: float

    def given_off(self, volume: float) -> float:
        """Return what it gives off whatever there is, unit µm³ / min."""
        return self.secretion * self.target * volume + max(self.export, 0.0)

    @property
    def taken_up(self) -> float:
        """First-order uptake per volume, 1/min."""
        return self.uptake + self.secretion


def read_secretion(model: Model) -> None:
    """Read ``secretion`` of all types; to be called when the substances are known."""
    for _, table in model.each("secretion"):
        for one in table.all("substrate"):
            if one.attributes.get("name") not in model.fields:
                problem = f"is of '{one.attributes.get('name')}', which is no substance"
                raise one.error(problem)
    for name in model.fields:
        known = {kind: _exchange(kind, name) for kind in model.kinds}
        _set_field(model, name, known)
        for kind in model.kinds:
            found = _substrate(kind, name, own=True)
            if found is not None:
                _account_for(model, kind, name, found, known[kind])


def _substrate(kind: Kind, name: str, *, own: bool = False) -> Element | None:
    table = kind.own("secretion") if own else kind.given("secretion")
    found = [] if table is None else table.all("substrate")
    return next((one for one in found if one.attributes.get("name") == name), None)


def _exchange(kind: Kind, name: str) -> Exchange:
    found = _substrate(kind, name)

    def number(tag: str) -> float:
        one = None if found is None else found.find(tag)
        least = None if tag == "net_export_rate" else 0.0
        return 0.0 if one is None else one.number(at_least=least)

    return Exchange(
        number("secretion_rate"), number("secretion_target"), number("uptake_rate"),
        number("net_export_rate"),
    )  # fmt: skip


def _set_field(model: Model, name: str, known: dict[Kind, Exchange]) -> None:
    key, unit = model.fields[name], model.unit[name]
    made = model.part("nutrients", key)
    top = max([model.top[name], *(x.target for x in known.values() if x.secretion > 0.0)])
    fastest = max(x.taken_up for x in known.values())
    if fastest > 0.0:
        half = min(max(_FAR * top * unit, _FAR * 1e-6), _MAX_HALF)
        del made["uptake"]
        made["half_saturation"] = half
        made["uptake_per_volume"] = fastest / MINUTE * half
        _by_type(model, "uptake_of", key, {k: x.taken_up / fastest for k, x in known.items()})
    given = {kind: x.given_off(kind.volume) for kind, x in known.items()}
    most = max(given.values())
    if most > 0.0:
        made["secretion"] = most * unit / MINUTE
        _by_type(model, "secretion_of", key, {kind: x / most for kind, x in given.items()})


def _by_type(model: Model, table: str, key: str, factors: dict[Kind, float]) -> None:
    """Set factors of types on what they do with a field."""
    for kind, factor in factors.items():
        if factor != 1.0 and len(model.kinds) > 1:
            model.part("types", kind.key, table)[key] = factor


def _account_for(model: Model, kind: Kind, name: str, found: Element, does: Exchange) -> None:
    key = f"nutrients.{model.fields[name]}"
    takes, gives = f"{key}.uptake_per_volume", f"{key}.secretion"
    near = "uptake saturates, a thousand times above the largest concentration that is named"
    size = f"of a cell of {kind.volume:g} um^3 whatever its size"
    entries = {
        "uptake_rate": (does.uptake != 0.0, Fate.APPROXIMATED, takes, near),
        "secretion_rate": (does.secretion != 0.0, Fate.APPROXIMATED, gives,
                           f"S T given off, {size}, and S c taken up"),
        "secretion_target": (does.secretion * does.target != 0.0, Fate.MAPPED, gives, ""),
        "net_export_rate": (does.export != 0.0, Fate.MAPPED, gives, ""),
    }  # fmt: skip
    if does.export < 0.0:
        note = "uptake at a rate that does not depend on the concentration"
        entries["net_export_rate"] = True, Fate.LEFT_OUT, "", note
    for tag, (acts, fate, to, note) in entries.items():
        one = found.find(tag)
        if one is not None and acts:
            model.account.take(one, fate, to, note)
        elif one is not None:
            model.account.take(one, Fate.OFF)
