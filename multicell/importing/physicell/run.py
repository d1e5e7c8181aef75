"""Space, time, output and options."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from multicell.errors import SceneError
from multicell.importing.imported import Fate
from multicell.importing.physicell.model import MINUTE, Model
from multicell.scene.domain import filling
from multicell.units import whole_number

if TYPE_CHECKING:
    from multicell.importing.files import Element

_FARTHEST, _FINEST = 1e6, 0.1
"""Farthest place and shortest side of a voxel, µm."""


def read_run(model: Model) -> None:
    """Read ``domain``, ``overall``, ``save`` and the seed."""
    _read_domain(model)
    overall = _required(model.root, "overall")
    every = model.root.find("save/full_data/interval")
    last, dt = _required(overall, "max_time"), overall.number_at("dt_phenotype", 6.0, above=0.0)
    duration = last.number(at_least=0.0)
    if duration == 0.0:
        note, duration = "one coupling step; PhysiCell saves the start alone", dt
        model.account.take(last, Fate.APPROXIMATED, "duration", note)
    model.scene["duration"] = duration * MINUTE
    model.scene["coupling_step"] = dt * MINUTE
    if every is not None and not every.is_off() and every.number() > 0.0:
        model.part("output")["every"] = every.number() * MINUTE
    seeds = ("options/random_seed", "user_parameters/random_seed")
    seed = next(filter(None, map(model.root.find, seeds)), None)
    if seed is None:
        return
    word = seed.word().removesuffix(".0")
    if (number := whole_number(word)) is not None:
        model.scene["seed"] = number
    elif word in ("", "random", "system_clock"):
        note = "every run has a seed here: 0"
        model.account.take(seed, Fate.APPROXIMATED, "seed", note)
    else:
        raise SceneError(f"{seed.file}, line {seed.line}", f"is {word[:60]!r}, no random seed")


def _required(above: Element, path: str) -> Element:
    found = above.find(path)
    if found is None:
        raise above.error(f"has no {path}")
    return found


def voxel_side(model: Model) -> float:
    """Return the side of the voxels, µm; of boxes that are no cubes the shortest."""
    axes = "xyz"[: model.scene["dimensions"]]
    sides = [_required(model.root, f"domain/d{axis}") for axis in axes]
    return min(side.number(at_least=_FINEST, at_most=_FARTHEST) for side in sides)


def _read_domain(model: Model) -> None:
    box, take, ends = _required(model.root, "domain"), model.account.take, {}
    plane = box.find("use_2D")
    flat = plane is not None and plane.flag()
    model.scene["dimensions"], axes = (2, "xy") if flat else (3, "xyz")
    spacing = voxel_side(model)
    for axis in axes:
        low, high = (_required(box, f"{axis}_{end}") for end in ("min", "max"))
        first, last = (end.number(at_least=-_FARTHEST, at_most=_FARTHEST) for end in (low, high))
        ends[axis] = first, last
        if not first < last:
            raise low.error(f"is {low.word()}, must be below {axis}_max, {high.word()}")
    widened = _fitting(ends, spacing)
    for axis in axes:
        model.part("domain")[axis] = list(widened[axis])
        for end, was, now in zip(("min", "max"), ends[axis], widened[axis], strict=True):
            if was != now:
                note = f"{now:g} um: whole cubes of one size must fill the box"
                take(box.find(f"{axis}_{end}"), Fate.APPROXIMATED, f"domain.{axis}", note)
    if flat:
        note = "in two dimensions PhysiCell takes dz in its place"
        model.account.take_all(box.all("z_min") + box.all("z_max"), Fate.OFF, note=note)
        model.account.take_all(box.all("dz"), Fate.MAPPED, "nutrients.*.height")


def account_for_steps(model: Model) -> None:
    """Account for voxels and the step of phenotypes, when it is known whether they can be ours."""
    used = min((part["spacing"] for part in model.part("nutrients").values()), default=None)
    coupling_step = model.scene["coupling_step"]
    other = {
        f"domain/d{axis}": ("nutrients.*.spacing", 1.0, used, "um: cubes for cells of this size")
        for axis in "xyz"
    }
    other["overall/dt_phenotype"] = (
        "coupling_step",
        MINUTE,
        coupling_step,
        "s: motion and the cycle are held in a coupling step",
    )
    for path, (key, unit, ours, why) in other.items():
        for one in model.root.all(path):
            if ours is not None and one not in model.account and one.number() * unit != ours:
                model.account.take(one, Fate.APPROXIMATED, key, f"{ours:g} {why}")


def _fitting(
    ends: dict[str, tuple[float, float]], spacing: float
) -> dict[str, tuple[float, float]]:
    """Return the ends of a box that cubes fill: as they are, or widened evenly to whole cubes."""
    if filling([high - low for low, high in ends.values()], spacing) is not None:
        return ends
    made = {}
    for axis, (low, high) in ends.items():
        more = 0.5 * (math.ceil((high - low) / spacing - 1e-9) * spacing - (high - low))
        made[axis] = low - more, high + more
    return made
