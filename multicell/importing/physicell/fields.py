"""Substances: diffusion, decay, what is there at the start and on the sides of the box."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from multicell.importing.imported import Fate
from multicell.importing.physicell import run
from multicell.importing.physicell.model import MINUTE, Model, keys_of
from multicell.units import COMMON, oxygen_solubility

if TYPE_CHECKING:
    from multicell.importing.files import Element

_SLOWEST = 1e-6
"""Least diffusion coefficient of a scene, µm²/s."""
_BODY = 37.0


def name_fields(model: Model) -> None:
    """Find the names of substances here, and what one unit of each is."""
    variables = model.root.all("microenvironment_setup/variable")
    for variable in variables:
        if not variable.attributes.get("name"):
            raise variable.error("has no name")
    names = [variable.attributes["name"] for variable in variables]
    model.fields = dict(zip(names, keys_of(names, "field"), strict=True))
    if len(model.fields) < len(variables):
        raise variables[-1].error("has the name of another substance")
    for variable, name in zip(variables, names, strict=True):
        model.unit[name] = _unit(name, variable.attributes.get("units", ""))[0]


def read_fields(model: Model) -> None:
    """Read ``microenvironment_setup``; to be called when the size of cells is known."""
    variables = model.root.all("microenvironment_setup/variable")
    # BioFVM sets no side at all unless one substance has its condition on all of them
    active = any(_on_all(variable) for variable in variables)
    for variable in variables:
        _read_variable(model, variable, active)


def _on_all(variable: Element) -> bool:
    found = variable.find("Dirichlet_boundary_condition")
    return found is not None and found.says("enabled")


def _read_variable(model: Model, variable: Element, active: bool) -> None:
    name = variable.attributes["name"]
    key = model.fields[name]
    unit, fate, note = _unit(name, variable.attributes.get("units", ""))
    called = "" if key == name else f"called {key} here; "
    model.account.take(variable, fate, f"nutrients.{key}", called + note, name)
    made = model.part("nutrients", key)
    # nothing rests here: uptake is that of living cells, whatever they do
    made |= {"uptake": 0.0, "quiescent_uptake": 1.0, "geometry": "box"}
    # that of the voxels, unless cells are too small for them
    made["spacing"] = min(run.spacing(model.root), 4.0 * model.part("cells")["division_radius"])
    thickness = model.root.find("domain/dz")
    if model.scene["dimensions"] == 2 and thickness is not None:
        made["height"] = thickness.number()
    _read_transport(model, variable, made)
    start = variable.find("initial_condition")
    level = 0.0 if start is None or not start.word() else start.number(at_least=0.0)
    made["boundary"] = level * unit
    model.account.take(start, Fate.MAPPED, f"nutrients.{key}.boundary")
    levels = _read_sides(model, variable, active, made)
    model.top[name] = max([level, *levels])


def _unit(name: str, said: str) -> tuple[float, Fate, str]:
    """Return mM for one unit of a substance, and what that is."""
    if said in ("mM", *COMMON["mM"]):
        return COMMON["mM"].get(said, 1.0), Fate.MAPPED, f"{said} as {said}"
    if name.lower() == "oxygen" and said.lower() in ("mmhg", "dimensionless", "none", ""):
        factor = oxygen_solubility(_BODY) * COMMON["kPa"]["mmHg"]
        how = f"1 mmHg as {factor:.4g} mM, the solubility in water at 37 °C (Battino et al. 1983)"
        if said.lower() == "mmhg":
            return factor, Fate.MAPPED, how
        return factor, Fate.APPROXIMATED, f"'{said}' taken as mmHg, PhysiCell's usual unit: {how}"
    note = f"1 {said or 'unit'} stands for 1 mM: no amount is known, and the equations are linear"
    return 1.0, Fate.APPROXIMATED, note


def _read_transport(model: Model, variable: Element, made: dict[str, Any]) -> None:
    key, account = model.fields[variable.attributes["name"]], model.account
    diffusion = variable.find("physical_parameter_set/diffusion_coefficient")
    decay = variable.find("physical_parameter_set/decay_rate")
    value = 0.0 if diffusion is None else diffusion.number(at_least=0.0) / MINUTE
    made["diffusion"] = max(value, _SLOWEST)
    slow = f"{_SLOWEST:g} um^2/s, the least there is: it stays where it is"
    fate, note = (Fate.APPROXIMATED, slow) if value < _SLOWEST else (Fate.MAPPED, "")
    account.take(diffusion, fate, f"nutrients.{key}.diffusion", note)
    if decay is not None:
        made["decay"] = decay.number(at_least=0.0) / MINUTE
        account.take(decay, Fate.MAPPED, f"nutrients.{key}.decay")


def _read_sides(model: Model, variable: Element, active: bool, made: dict[str, Any]) -> list[float]:
    """Set the sides of a field; return the values that they have, in the substance's unit."""
    name = variable.attributes["name"]
    unit, path = model.unit[name], f"nutrients.{model.fields[name]}.sides"
    all_sides = variable.find("Dirichlet_boundary_condition")
    on_all = _on_all(variable)
    value = all_sides.number(at_least=0.0) if all_sides is not None and on_all else 0.0
    axes = "xyz"[: model.scene["dimensions"]]
    levels = {f"{a}{e}": (on_all, value) for a in axes for e in "-+"}
    model.account.take(all_sides, Fate.MAPPED if on_all else Fate.OFF, path if on_all else "")
    for one in variable.all("Dirichlet_options/boundary_value"):
        side = one.attributes.get("ID", "")
        face = side[:1] + {"min": "-", "max": "+"}.get(side[1:], "")
        if face not in levels:
            named = side not in ("zmin", "zmax")  # those a plane does not have
            model.account.leave_out([one], "no side of this name", acts=named)
            continue
        on = one.says("enabled")
        levels[face] = on, one.number(at_least=0.0) if on and active else 0.0
        if on and not active:
            note = "PhysiCell sets no side unless a Dirichlet_boundary_condition is enabled"
            model.account.take(one, Fate.OFF, note=note)
        else:
            model.account.take(one, Fate.MAPPED, f"{path}.{face}", "" if on else "a wall")
    held = {face: level for face, (on, level) in levels.items() if on and active}
    wall: dict[str, Any] = {"type": "derivative", "derivative": 0.0}
    sides = {
        face: {"type": "value", "value": held[face] * unit} if face in held else wall
        for face in levels
    }
    alike = all(side == sides["x-"] for side in sides.values())
    made["sides"] = {"*": sides["x-"]} if alike else sides
    return list(held.values())
