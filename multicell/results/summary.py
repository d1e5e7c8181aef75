"""The history and the summary of a run: observables of its state, as its scene asks for them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from multicell.results import observables
from multicell.results.folder import versions
from multicell.results.observables import known
from multicell.results.quantities import units_of
from multicell.scene.coupling import fixed_step
from multicell.scene.domain import walls

if TYPE_CHECKING:
    from multicell.results.frame import Frame
    from multicell.scene.scene import Scene


def history_row(scene: Scene, frame: Frame, **extra: float) -> dict[str, float]:
    """Return one row of a run's history: :func:`observables.history_row`, and what scenes add.

    Added are ``contacts`` where the run counts them, ``heterotypic_fraction`` where there are
    types, ``hypoxic_radius_<field>`` (µm) where cells rest without a field, the ``pull`` (nN),
    :func:`observables.confinement` within walls, and ``pressure_factor`` and ``held_by_pressure``
    where pressure limits growth, and what is given as ``extra``.
    """
    own: dict[str, float] = {}
    if counts_contacts(scene):
        own["contacts"] = len(frame.contacts)
    own |= _mixing(scene, frame)
    extent = observables.Extent(frame.cells, scene.dimensions)
    own |= {f"hypoxic_radius_{name}": r for name, r in _hypoxic(scene, frame, extent).items()}
    own |= extra
    if scene.pull is not None:
        own["pull"] = scene.pull.load(frame.time)
    own |= _confined(scene, frame)
    own |= _held_back(scene, frame)
    return observables.history_row(
        frame.time, frame.step, frame.cells, scene.dimensions, extent, **own
    )


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

    Parameters
    ----------
    scene
    frame
        With its progress.
    ledgers : field -> name -> amount in amol, or a ratio
    fields, remarks
        What each field lives on, and remarks on fields that do not fit; see
        :meth:`multicell.nutrient.fields.Feeding.fitness`.
    wall : phase -> s
    threads
        Number of threads.
    """
    from multicell.scene.packing import packing_notes

    progress = frame.progress
    assert progress is not None
    extent = observables.Extent(frame.cells, scene.dimensions)
    own = observables.state_summary(frame.time, frame.cells, scene.dimensions, extent)
    confined = _confined(scene, frame)
    remainders = [entry["relative_remainder"] for entry in ledgers.values()]
    optional: dict[str, Any] = {
        "hypoxic_radius": _hypoxic(scene, frame, extent),
        "separation": progress.separation,
        "fields": fields,
        "start": progress.first_states,
        "notes": [
            *packing_notes(scene, own["packing_ratio"], confined.get("volume_fraction")),
            *_start_notes(progress.first_states),
            *remarks,
        ],
    }
    summary = {
        **own,
        **confined,
        **{name: known(value) for name, value in _held_back(scene, frame).items()},
        **{name: known(value) for name, value in _mixing(scene, frame).items()},
        **_splitting(scene, frame),
        "title": scene.title,
        "seed": scene.seed,
        "steps": frame.step,
        "divisions": progress.divisions,
        "removals": progress.removals,
        "volume_released": progress.released,
        "integrator": {
            "method": scene.integrator.method,
            **progress.work,
            **_shift(progress.replays),
            **_stability(progress.stability),
        },
        "ledger": {**ledgers, **({"relative_remainder": max(remainders)} if remainders else {})},
        **{name: value for name, value in optional.items() if value},
        "wall": {**wall, "total": sum(wall.values())},
        "threads": threads,
        "versions": versions(),
    }
    return {**summary, "units": units_of(summary)}


def _shift(replays: Mapping[str, float]) -> dict[str, float]:
    """Return what replays from shifted positions have found, where there were any."""
    if not replays.get("done"):
        return {}
    return {"replays": int(replays["done"]), "largest_shift_effect": replays["largest"]}


def _stability(known: Mapping[str, float]) -> dict[str, float]:
    """Return how far a fixed step was from its limit of stability, where it has one."""
    if not known.get("measured"):
        return {}
    return {
        "stability_checks": int(known["measured"]),
        "checks_beyond_stability": int(known["beyond"]),
        "largest_stability_ratio": known["largest"],
    }


def counts_contacts(scene: Scene) -> bool:
    """Return whether anything asks for the pairs in contact; to find them costs a little."""
    return remembers_contacts(scene) or len(scene.types) > 1 or scene.pull is not None


def remembers_contacts(scene: Scene) -> bool:
    """Return whether the contact law needs to know which pairs were in contact."""
    return scene.contact.remembers


def _start_notes(states: Mapping[str, int]) -> list[str]:
    """Return remarks on the states of cells at the start."""
    notes = []
    if states.get("necrotic"):
        notes.append(
            f"At the start {states['quiescent']:,} cells rest and {states['necrotic']:,} are dead: "
            "they find too little in the field that all cells make, as in tissue that has been "
            "there for long."
        )
    if states.get("unfit"):
        notes.append(
            f"The states of {states['unfit']:,} cells at the start do not fit the field: resting "
            "or dead cells lower what others find, and no states were found that fit."
        )
    return notes


def _confined(scene: Scene, frame: Frame) -> dict[str, float]:
    """Return how cells fill a box with elastic walls, where there is one in space."""
    if scene.dimensions == 2:
        return {}
    box = walls(scene)
    return {} if box is None else observables.confinement(frame.cells, box)


def _held_back(scene: Scene, frame: Frame) -> dict[str, float]:
    """Return how much pressure holds growth back, where it does."""
    growth = scene.growth
    if growth is None or growth.critical_pressure is None:
        return {}
    return dict(observables.pressure_summary(frame.cells, growth.critical_pressure))


def _splitting(scene: Scene, frame: Frame) -> dict[str, Any]:
    """Return the error that coupling steps have made with the volume of all cells, with growth."""
    progress = frame.progress
    if progress is None or progress.splitting is None:
        return {}
    volume, error = float(frame.cells.volume.sum()), progress.splitting * len(frame.cells)
    entries = {"volume_error": error}
    if volume > 0.0:
        entries["relative_volume_error"] = error / volume
    if fixed_step(scene) is None and frame.step:
        entries["mean_step"] = frame.time / frame.step
    return {"splitting": entries}


def _hypoxic(scene: Scene, frame: Frame, extent: observables.Extent) -> dict[str, float]:
    """Return the radius in which cells lack each field that makes them rest, µm."""
    return {
        name: observables.hypoxic_radius(
            frame.cells, frame.concentrations[name], field.quiescence, scene.dimensions, extent
        )
        for name, field in scene.nutrients.items()
        if field.quiescence is not None and name in frame.concentrations
    }


def _mixing(scene: Scene, frame: Frame) -> dict[str, float]:
    """Return how the types mix, where there is more than one."""
    if len(scene.types) < 2:
        return {}
    fraction = observables.heterotypic_fraction(frame.cells, frame.contacts)
    return {"heterotypic_fraction": fraction}
