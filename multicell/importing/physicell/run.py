"""Space, time, output and options."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from multicell.errors import SceneError
from multicell.importing.imported import Fate
from multicell.importing.physicell.model import MINUTE, Model
from multicell.scene.domain import filling

if TYPE_CHECKING:
    from multicell.importing.files import Element

_FARTHEST, _FINEST = 1e6, 0.1
"""Farthest place and shortest side of a voxel, µm."""


def read_run(model: Model) -> None:
    """Read ``domain``, ``overall``, ``save`` and the seed."""
    _read_domain(model)
    _read_overall(model)
    _read_save(model)
    seeds = ("options/random_seed", "user_parameters/random_seed")
    seed = next(filter(None, map(model.root.find, seeds)), None)
    if seed is not None:
        _read_seed(model, seed)


def _required(above: Element, path: str) -> Element:
    found = above.find(path)
    if found is None:
        raise above.error(f"has no {path}")
    return found


def is_flat(root: Element) -> bool:
    """Return whether the model lies in a plane."""
    found = root.find("domain/use_2D")
    return found is not None and found.flag()


def spacing(root: Element) -> float:
    """Return the side of the voxels, µm; of boxes that are no cubes the shortest."""
    sides = [_required(root, f"domain/d{axis}") for axis in "xyz"[: 2 if is_flat(root) else 3]]
    return min(side.number(at_least=_FINEST, at_most=_FARTHEST) for side in sides)


def _read_domain(model: Model) -> None:
    root, take = model.root, model.account.take
    flat = is_flat(root)
    model.scene["dimensions"] = 2 if flat else 3
    box, step = _required(root, "domain"), spacing(root)
    ends: dict[str, tuple[float, float]] = {}
    axes = "xy" if flat else "xyz"
    for axis in axes:
        low, high = (_required(box, f"{axis}_{end}") for end in ("min", "max"))
        first, last = (end.number(at_least=-_FARTHEST, at_most=_FARTHEST) for end in (low, high))
        ends[axis] = first, last
        if not first < last:
            raise low.error(f"is {low.word()}, must be below {axis}_max, {high.word()}")
    widened = _fitting(ends, step)
    for axis in axes:
        model.part("domain")[axis] = list(widened[axis])
        for end, was, now in zip(("min", "max"), ends[axis], widened[axis], strict=True):
            note = "" if was == now else f"{now:g} um: whole cubes of one size must fill the box"
            fate = Fate.MAPPED if was == now else Fate.APPROXIMATED
            take(_required(box, f"{axis}_{end}"), fate, f"domain.{axis}", note)
    take(box.find("use_2D"), Fate.MAPPED, "dimensions")
    if flat:
        note = "in two dimensions PhysiCell takes dz in its place"
        model.account.take_all(box.all("z_min") + box.all("z_max"), Fate.OFF, note=note)


def account_for_voxels(model: Model) -> None:
    """Account for the sides of the voxels, when it is known how fine grids are."""
    used = min((part["spacing"] for part in model.part("nutrients").values()), default=0.0)
    for axis in "xyz":
        for side in model.root.all(f"domain/d{axis}"):
            if not model.root.all("microenvironment_setup/variable"):
                model.account.take(side, Fate.OFF, note="there are no substances")
            elif axis == "z" and model.scene["dimensions"] == 2:
                model.account.take(side, Fate.MAPPED, "nutrients.*.height")
            elif side.number() == used:
                model.account.take(side, Fate.MAPPED, "nutrients.*.spacing")
            else:
                note = f"{used:g} um: cubes, no longer than two cells that divide"
                model.account.take(side, Fate.APPROXIMATED, "nutrients.*.spacing", note)


def _fitting(ends: dict[str, tuple[float, float]], step: float) -> dict[str, tuple[float, float]]:
    """Return the ends of a box that cubes fill: as they are, or widened evenly to whole cubes."""
    if filling([high - low for low, high in ends.values()], step) is not None:
        return ends
    made = {}
    for axis, (low, high) in ends.items():
        more = 0.5 * (math.ceil((high - low) / step - 1e-9) * step - (high - low))
        made[axis] = low - more, high + more
    return made


def _read_overall(model: Model) -> None:
    overall, take = _required(model.root, "overall"), model.account.take
    end = _required(overall, "max_time")
    model.scene["duration"] = end.number(above=0.0) * MINUTE
    take(end, Fate.MAPPED, "duration")
    for tag, usual in (("time_units", "min"), ("space_units", "micron")):
        found = overall.find(tag)
        if found is not None and found.word() in (usual, "minutes", "microns", "um"):
            take(found, Fate.MAPPED, note="all numbers are converted to s and um")
        elif found is not None:
            note = f"PhysiCell only prints it: numbers are taken in {usual}, as there"
            take(found, Fate.APPROXIMATED, note=note)
    found = overall.find("dt_phenotype")
    model.scene["coupling_step"] = (6.0 if found is None else found.number(above=0.0)) * MINUTE


def account_for_step(model: Model) -> None:
    """Account for the step of phenotypes, when it is known whether it can be ours."""
    for found in model.root.all("overall/dt_phenotype"):
        step = model.scene["coupling_step"]
        if step == found.number() * MINUTE:
            model.account.take(found, Fate.MAPPED, "coupling_step")
        else:
            note = f"{step:g} s: motion by the cells themselves is held in a coupling step"
            model.account.take(found, Fate.APPROXIMATED, "coupling_step", note)


def _read_save(model: Model) -> None:
    save = model.root.find("save")
    if save is None:
        return
    take_all = model.account.take_all
    enabled, every = save.find("full_data/enable"), save.find("full_data/interval")
    on = enabled is None or enabled.flag()
    if every is not None and on and every.number() > 0.0:
        model.part("output")["every"] = every.number() * MINUTE
        model.account.take(every, Fate.MAPPED, "output.every")
        take_all(save.all("full_data/enable"), Fate.MAPPED, "output.every")
    take_all(save.all("full_data"), Fate.OFF)


def _read_seed(model: Model, seed: Element) -> None:
    word = seed.word().removesuffix(".0")
    if word.isdecimal() and int(word) < 2**63:
        model.scene["seed"] = int(word)
        note = "the same seed gives other random numbers than in PhysiCell"
        model.account.take(seed, Fate.MAPPED, "seed", note)
    elif word in ("", "random", "system_clock"):
        note = "every run has a seed here: 0"
        model.account.take(seed, Fate.APPROXIMATED, "seed", note)
    else:
        raise SceneError(f"{seed.file}, line {seed.line}", f"is {word[:60]!r}, no random seed")
