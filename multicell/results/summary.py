"""The history and the summary of a run: the observables of its scene, and what the run adds."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from multicell.errors import OutputError
from multicell.results.documents import read_document
from multicell.results.folder import versions
from multicell.results.measures import scene_observables
from multicell.results.observable import TissueState, represented
from multicell.results.quantities import units_of
from multicell.scene.sizes import birth_volumes
from multicell.scene.steps import Lengths

if TYPE_CHECKING:
    from multicell.cells import Cells
    from multicell.results.frame import Frame, Progress
    from multicell.results.reader import Contents
    from multicell.scene.scene import Scene


def history_row(state: TissueState, **found: float) -> dict[str, float]:
    """Return one row of a run's history as floats; NaN where a number does not exist.

    ``**found`` are further columns: what the coupling step has found.
    """
    scene, frame = state.scene, state.frame
    row = {"time": frame.time, "step": float(frame.step)}
    for observable, key in scene_observables(scene):
        if observable.measure is not None:
            row[observable.name.replace("*", key)] = float(observable.value(state, key))
    amiss = _splitting(scene, frame.cells)
    if amiss:
        row["splitting_volume_error"] = amiss["relative_volume_error"]
        row["splitting_worst_cell_error"] = amiss["worst_cell_error"]
    return row | {name: float(value) for name, value in found.items()}


def state_summary(scene: Scene, frame: Frame, *, own: bool = True) -> dict[str, Any]:
    """Return the part of a summary that follows from the state alone.

    A number that does not exist (the viable rim without a core) is None. Observables of the user's
    ``own`` are left out where their functions need not be there.
    """
    state = TissueState(frame, scene)
    summary: dict[str, Any] = {"time": float(frame.time)}
    for observable, key in scene_observables(scene, own=own):
        if observable.measure is not None and observable.entry is not None:
            *tables, name = observable.entry.replace("*", key).split(".")
            place = summary
            for table in tables:
                place = place.setdefault(table, {})
            value = observable.value(state, key)
            place[name] = None if math.isnan(value) else value
    return summary


def run_summary(
    scene: Scene,
    frame: Frame,
    ledgers: Mapping[str, Mapping[str, float]],
    fields: Mapping[str, Mapping[str, Any]],
    remarks: Sequence[str],
    wall: Mapping[str, float],
    threads: int,
) -> dict[str, Any]:
    """Return the numbers that describe a run up to a frame; ``units`` names their units.

    A number that does not exist (the viable rim without a core) is None.

    - ``frame``: with its progress
    - ``ledgers``, field -> name -> amount in amol, or a ratio
    - ``fields``, ``remarks``: what each field lives on, and remarks on fields that do not fit; see
      :meth:`multicell.nutrient.fields.FieldSystem.fitness`
    - ``wall``, phase -> s
    - ``threads``: number of threads
    """
    from multicell.scene.packing import packing_notes

    progress = frame.progress
    assert progress is not None
    own = state_summary(scene, frame)
    remainders = [entry["relative_remainder"] for entry in ledgers.values()]
    optional: dict[str, Any] = {
        "separation": progress.separation,
        "fields": fields,
        "start": progress.first_states,
        "notes": [
            *packing_notes(scene, own["packing_ratio"], own.get("volume_fraction")),
            *_start_notes(progress.first_states),
            *_giant_notes(scene, frame.cells),
            *_death_notes(progress.exposures),
            *remarks,
        ],
    }
    splitting = _splitting(scene, frame.cells)
    if "error" in progress.exposures:
        splitting["events_error"] = abs(progress.exposures["error"])
    if "networks" in progress.exposures:
        splitting["networks_error"] = progress.exposures["networks"]
    if progress.lengths:
        steps = Lengths(*progress.lengths)
        splitting["first_order_error"] = steps.error
        lengths = {"shortest": steps.shortest, "longest": steps.longest}
        optional["coupling_steps"] = {**lengths, "exceeded": int(steps.exceeded)}
    summary = {
        **own,
        **({"splitting": splitting} if splitting else {}),
        "title": scene.title,
        "seed": scene.seed,
        "steps": frame.step,
        "divisions": represented(scene, progress.divisions),
        "removals": represented(scene, progress.removals),
        "volume_released": progress.released,
        "integrator": {
            "method": scene.integrator.method,
            **progress.work,
            **_checks(progress),
        },
        "ledger": {**ledgers, **({"relative_remainder": max(remainders)} if remainders else {})},
        **{name: value for name, value in optional.items() if value},
        "wall": {**wall, "total": sum(wall.values())},
        "threads": threads,
        "versions": versions() | _pack_version(),
    }
    return {**summary, "units": units_of(summary)}


def _pack_version() -> dict[str, str]:
    """Return for what processors kernels of this process were compiled, if they are of a pack."""
    from multicell.compiling.numba_068 import installed_pack, processor  # a run has loaded numba

    pack = installed_pack(processor())
    return {"multicell-kernels": pack.level} if pack is not None and pack.loaded else {}


def _checks(progress: Progress) -> dict[str, float]:
    """Return the findings of replays from shifted positions and checks of stability, if any."""
    found: dict[str, float] = {}
    replays, known = progress.replays, progress.stability
    if replays.get("done"):
        found["replays"] = int(replays["done"])
        found["largest_shift_effect"] = replays["largest"]
    if known.get("measured"):
        found["stability_checks"] = int(known["measured"])
        found["checks_beyond_stability"] = int(known["beyond"])
        found["largest_stability_ratio"] = known["largest"]
    return found


def _start_notes(states: Mapping[str, int]) -> list[str]:
    notes = []
    if states.get("necrotic"):
        notes.append(
            f"Start states: {states['quiescent']:,} quiescent, {states['necrotic']:,} necrotic. "
            "The field that all cells make leaves them too little, as in tissue that has been "
            "there for long."
        )
    if states.get("unfit"):
        notes.append(
            f"The states of {states['unfit']:,} cells at the start do not fit the field: resting "
            "or dead cells lower concentrations of others, and no states were found that fit."
        )
    return notes


_GIANT = 1.1
"""Volume of a living cell over that of division from which on it is noted: a step's growth is less.
"""


def _death_notes(exposures: Mapping[str, float]) -> list[str]:
    """Return in words in how many steps deaths have not settled."""
    count = int(exposures.get("unsettled", 0.0))
    if not count:
        return []
    where = "one coupling step" if count == 1 else f"{count} coupling steps"
    return [
        f"In {where} deaths or changes of type that change what other cells are exposed to did not "
        "settle; they are counted in the error of deaths. A shorter coupling_step keeps them apart."
    ]


def _giant_notes(scene: Scene, cells: Cells) -> list[str]:
    """Return a remark on living cells that are larger than those that divide."""
    ratio = (cells.volume / (2.0 * birth_volumes(scene, cells.kind)))[~cells.dead]
    giants = int((ratio > _GIANT).sum())
    if scene.growth is None or not giants:
        return []
    return [
        f"{giants:,} living cell(s) are larger than at division, the largest {ratio.max():.3g} "
        "times: cells that are held in a phase keep growing. growth.hypertrophy = false stops them "
        "at the volume of division."
    ]


def _splitting(scene: Scene, cells: Cells) -> dict[str, float]:
    """Return the volume by which cells have grown too much for fixed rates, in a scene with growth.

    Of all together in µm³ and over their volume, and the largest part of a living cell's volume.
    """
    if scene.growth is None:
        return {}
    volume, living = cells.volume, ~cells.dead
    scales, law = scene.growth.target_scales, scene.growth.growth_law
    birth = birth_volumes(scene, cells.kind)
    if scales is None:
        rate = law.rate(volume, birth) / cells.cycle_time
    else:
        scale = scales[cells.phase]
        rate = scale * law.rate(volume / scale, birth) / cells.cycle_time
    excess = np.where(living, -rate * cells.lag, 0.0)
    total, error = float(volume.sum()), float(excess.sum())
    return {
        "volume_error": error,
        "relative_volume_error": error / total if total > 0.0 else 0.0,
        "worst_cell_error": float(np.abs(excess / volume).max(initial=0.0)),
    }


def scene_mark(text: str) -> str:
    """Return the mark of a scene in a summary: a digest of the text that the frames hold too."""
    return hashlib.sha256(text.encode()).hexdigest()[:24]


def read_summary(contents: Contents) -> dict[str, Any] | None:
    """Return the summary in a result folder, None where there is none.

    Raises OutputError for one that is damaged, or of another run than the frames beside it.
    """
    path = contents.folder / "summary.json"
    summary = read_document(path)
    if summary is None:
        return None
    if "scene_digest" in summary:
        same = summary["scene_digest"] == scene_mark(contents.scene)
    else:  # an older version has written it
        same = all(
            (summary.get("time", end.time), summary.get("steps", end.step_index))
            == (end.time, end.step_index)
            for end in contents.places[-1:]
        )
    if not same:
        raise OutputError(f"'{path}' is of another run than the frames beside it", damaged=True)
    return summary
