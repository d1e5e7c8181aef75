"""WM983b melanoma spheroids in air and in 2 % oxygen: what makes cells rest, die and use less.

Problem   spheroids in air and in 2 % oxygen from seeding on, and switched from one to the other
Data      docs/data/wm983b-oxygen.csv (Murphy et al. 2022): means of the first two regimes
Model     the scene `wm983b` with cells of three times the diameter, and one mechanism more each
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import multicell as mc

COARSE = 3
AIR, LOW = "21 %", "2 %"
SWITCH, LAST = 2.0, 8.0
"""Day of the change from air to 2 % oxygen, and that on which runs end."""
BEGIN = "day on which cells have become a spheroid"
SHARE = "cells of it in 2 %, of those in air"


@mc.network(
    states={"state": 0.0},
    inputs={"oxygen": 0.1},
    parameters={"level": 0.014, "delay": 86400.0},
    units={"oxygen": "mM"},
)
def hypoxia(t, y, u, p, out):  # type: ignore[no-untyped-def]
    """State that follows hypoxia with a delay: 0 in cells that have oxygen, 1 in those without."""
    out[0] = (p[0] ** 4 / (p[0] ** 4 + u[0] ** 4) - y[0]) / p[1]


@mc.network(
    states={"state": 0.0, "taken": 0.0},
    inputs={"oxygen": 0.1, "volume": 2000.0},
    parameters={"level": 0.014, "delay": 2e4, "uptake": 0.03, "left": 0.3, "half": 0.005},
    units={"oxygen": "mM", "volume": "um^3"},
)
def pasteur(t, y, u, p, out):  # type: ignore[no-untyped-def]
    """Uptake of oxygen that falls within hours of hypoxia, to a part ``left`` of what it was."""
    out[0] = (p[0] ** 4 / (p[0] ** 4 + u[0] ** 4) - y[0]) / p[1]
    rate = p[2] * u[1] * u[0] / (p[4] + u[0]) * (1.0 - (1.0 - p[3]) * y[0])
    out[1] = (rate - y[1]) / 60.0


@dataclass(frozen=True)
class Mechanism:
    """Additional keys of a variant of the scene, and those that are fitted.

    - ``says``: in words, for tables
    - ``changes``: of the scene
    - ``free``: ranges of keys besides those of all variants
    - ``without``: keys of all variants that are not fitted
    - ``own``: ranges of what is fitted and is no key of a scene: `BEGIN` and `SHARE`
    - ``begin``: places in the ranges where a search begins; none: at the best of the fits before
    """

    says: str
    changes: dict[str, Any] = field(default_factory=dict)
    free: dict[str, str] = field(default_factory=dict)
    without: tuple[str, ...] = ()
    own: dict[str, tuple[float, float]] = field(default_factory=dict)
    begin: dict[str, float] = field(default_factory=dict)


SHARED = {
    "initial.count": "log 90:450",
    "growth.phases.G1.duration": "10:80 h",
    "nutrients.oxygen.uptake_per_volume": "log 0.005:0.06 mM/s",
    "nutrients.oxygen.layer": "log 20:4000 um",
    "nutrients.oxygen.quiescence": "log 1e-4:0.04 mM",
    "nutrients.oxygen.relative.necrosis.factor": "log 0.02:0.98",
    "death.damage_time": "0.3:6 d",
    "death.lysis_time": "log 1:30 d",
}
"""Ranges of what is fitted in all variants; the number of cells is that of the coarse scene."""

_SLOWER = {"nutrients.oxygen.growth_half_saturation": "log 1e-4:0.05 mM"}
_LESS = {"nutrients.oxygen.half_saturation": "log 0.001:0.1 mM"}
_NETWORK = {
    "networks.hypoxia.network": hypoxia,
    "networks.hypoxia.inputs": {"oxygen": "oxygen"},
    "networks.hypoxia.dilution": False,
    "networks.hypoxia.parameters": {"level": 0.014, "delay": 86400.0},
}
_FAR_ABOVE = _SLOWER | {
    "nutrients.oxygen.uptake_per_volume": "log 0.005:2 mM/s",
    "nutrients.oxygen.half_saturation": "log 0.001:1 mM",
}
_FORMED = {BEGIN: (0.0, 1.95), SHARE: (0.4, 1.0)}
_NO_LAYER = ("nutrients.oxygen.layer",)

MECHANISMS = {
    "thresholds": Mechanism("rest and death below levels of oxygen, after a time"),
    "stirred": Mechanism(
        "the same without a layer of still medium",
        {"nutrients.oxygen.layer": "20 um"},
        without=_NO_LAYER,
    ),
    "slower": Mechanism("growth slows as oxygen falls (Monod)", free=_SLOWER),
    "less": Mechanism(
        "besides, uptake falls as oxygen does (its half saturation is fitted)",
        free=_SLOWER | _LESS,
    ),
    "formed": Mechanism(
        "uptake falls far above hypoxia, and the run begins when spheroids have formed",
        free=_FAR_ABOVE | {"death.damage_time": "log 1:6 d"},
        own=_FORMED,
        begin={
            "initial.count": 0.91,
            "growth.phases.G1.duration": 0.58,
            "nutrients.oxygen.uptake_per_volume": 0.77,
            "nutrients.oxygen.layer": 0.21,
            "nutrients.oxygen.quiescence": 0.52,
            "nutrients.oxygen.relative.necrosis.factor": 0.74,
            "death.damage_time": 0.55,
            "death.lysis_time": 0.41,
            "nutrients.oxygen.growth_half_saturation": 0.13,
            "nutrients.oxygen.half_saturation": 0.67,
            BEGIN: 0.69,
            SHARE: 0.31,
        },
    ),
    "quick": Mechanism(
        "the same, and cells without oxygen die within a day",
        free=_FAR_ABOVE | {"death.damage_time": "log 0.1:1 d"},
        own=_FORMED,
        begin={
            "initial.count": 0.82,
            "growth.phases.G1.duration": 0.58,
            "nutrients.oxygen.uptake_per_volume": 0.72,
            "nutrients.oxygen.layer": 0.02,
            "nutrients.oxygen.quiescence": 0.37,
            "nutrients.oxygen.relative.necrosis.factor": 0.43,
            "death.damage_time": 0.97,
            "death.lysis_time": 0.52,
            "nutrients.oxygen.growth_half_saturation": 0.17,
            "nutrients.oxygen.half_saturation": 0.54,
            BEGIN: 0.67,
            SHARE: 0.54,
        },
    ),
    "repair": Mechanism(
        "besides, damage heals",
        free=_SLOWER | _LESS | {"death.repair_rate": "log 0.01:3 1/d"},
    ),
    "relative": Mechanism(
        "besides, cells rest and die at parts of the oxygen that they were seeded in",
        {"nutrients.oxygen.quiescence": "0.1 boundary"},
        _SLOWER | _LESS | {"nutrients.oxygen.relative.quiescence.factor": "log 0.01:0.9"},
        ("nutrients.oxygen.quiescence",),
    ),
    "delayed": Mechanism(
        "besides, cells rest where a state that follows hypoxia in days is high",
        {
            **_NETWORK,
            "responses.rest": {
                "behaviour": "rest",
                "signal": "hypoxia.state",
                "law": "threshold",
                "half": 0.5,
                "largest": 1.0,
            },
        },
        _SLOWER
        | _LESS
        | {
            "networks.hypoxia.parameters.level": "log 0.002:0.04",
            "networks.hypoxia.parameters.delay": "log 1e4:4e5",
            "nutrients.oxygen.necrosis": "log 3e-5:0.02 mM",
        },
        ("nutrients.oxygen.quiescence", "nutrients.oxygen.relative.necrosis.factor"),
    ),
    "pasteur": Mechanism(
        "growth slows; uptake falls within hours of hypoxia",
        {
            "networks.pasteur.network": pasteur,
            "networks.pasteur.inputs": {"oxygen": "oxygen", "volume": "volume"},
            "networks.pasteur.fluxes": {"oxygen": "uptake: taken"},
            "networks.pasteur.dilution": False,
            "networks.pasteur.parameters": {"level": 0.014, "uptake": 0.03, "left": 0.3},
        },
        _SLOWER
        | {
            "networks.pasteur.parameters.uptake": "log 0.005:0.06",
            "networks.pasteur.parameters.level": "log 0.005:0.08",
            "networks.pasteur.parameters.left": "log 0.02:1",
        },
        ("nutrients.oxygen.uptake_per_volume",),
    ),
    "crowded": Mechanism(
        "growth slows; and ends at a pressure",
        free=_SLOWER | _LESS | {"growth.critical_pressure": "log 0.05:5 kPa"},
    ),
}


def variant(name: str, coarse: float = COARSE) -> mc.Scene:
    """Return the scene with a mechanism, in air, for the days that were measured."""
    base = {
        "nutrients.oxygen.boundary": AIR,
        "nutrients.oxygen.necrosis": "0.4 quiescence",
        "duration": "8 d",
        "coupling_step": "4 h",
        "output.every": "8 d",
    }
    found = MECHANISMS[name]
    if "responses.rest" in found.changes:
        base |= {"nutrients.oxygen.necrosis": "0.004 mM", "nutrients.oxygen.quiescence": None}
    scene = mc.load_scene("wm983b").with_changes(base | found.changes)
    return mc.coarsen(scene, coarse)


def free(name: str) -> dict[str, str]:
    """Return the ranges of what is fitted with a mechanism."""
    found = MECHANISMS[name]
    shared = {key: text for key, text in SHARED.items() if key not in found.without}
    return shared | found.free


def in_regime(scene: mc.Scene, regime: str, settings: dict[str, Any]) -> mc.Scene:
    """Return a variant with its parameters in ``"air"``, ``"hypoxia"`` or ``"switched"``.

    Cells come from air: where the run begins with a formed spheroid, those in 2 % begin with the
    states of cells in air.
    """
    keys = {key: value for key, value in settings.items() if key not in (BEGIN, SHARE)}
    begin, share = settings.get(BEGIN), settings.get(SHARE, 1.0)
    scene = scene.with_changes(keys)
    if begin is not None:
        scene = scene.with_changes({"duration": f"{LAST - begin} d"})
    if regime == "air":
        return scene
    after = SWITCH - (begin or 0.0)
    if regime == "hypoxia":
        if begin is None:
            return scene.with_changes({"nutrients.oxygen.boundary": LOW})
        count = round(scene.initial.count * share)
        scene, after = scene.with_changes({"initial.count": count}), 60 / 86400
    return scene.with_changes({"nutrients.oxygen.media": [["0 d", AIR], [f"{after} d", LOW]]})
