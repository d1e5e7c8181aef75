"""Built-in scenes with parts that they do not have, and a method: drawn by number."""

from __future__ import annotations

from pathlib import Path

from scene_strategies import relax

import multicell as mc
from multicell.errors import SceneError
from multicell.integrators.registry import METHODS

CELLS = 24
"""Most cells of a drawn scene, where its parts do not need more."""
STEPS = 3
ENERGY = {
    "file": str(Path(__file__).parents[1] / "networks" / "energy.ant"),
    "inputs": {"O_out": "oxygen"},
    "units": {"O_out": "mM"},
}
BOX = {f"domain.{axis}": ["-90 um", "90 um"] for axis in "xy"}
OXYGEN = {"nutrients.oxygen": {"boundary": "0.05 mM", "uptake": "40 amol/s", "spacing": "10 um"}}
TYPES = {"types": {"a": {"fraction": 0.5}, "b": {"fraction": 0.5, "young": "4 kPa"}}}
PHASES = {name: {"duration": "3 h"} for name in ("G1", "S", "G2", "M")}

PARTS = {
    "friction": {"friction": {}},
    "friction along": {"friction": {"normal": "0.2 kPa s/um", "tangential": 0}},
    "sphere": {"domain": {"shape": "sphere", "radius": "100 um"}},
    "tight sphere": {"domain": {"shape": "sphere", "radius": "14 um"}},
    "gel": {"domain": {"shape": "sphere", "radius": "12 um", "stiffness": "20 kPa"}},
    "box": {"domain": {}, **BOX, "domain.z": ["-90 um", "90 um"]},
    "tight box": {"domain": {}, **{f"domain.{axis}": ["-17 um", "17 um"] for axis in "xyz"}},
    "motility": {"motility": {"force": "0.5 nN"}},
    "random motility": {"motility": {"renewal": "random", "persistence": "1 min"}},
    "biased motility": {"motility": {"bias": 0.5, "direction": [1, 0, 0]}},
    "pull": {"pull": {"force": "0.05 nN", "rate": "1e-4 nN/s"}},
    "held cells": {"motions": {"held": {"cells": [0]}}},
    "driven cells": {"motions": {"driven": {"x": [0, 200], "velocity": [0.001, 0, 0]}}},
    "compression": {"compression": {}},
    "surface": {"surface": {"tension": "0.05 nN/um"}},
    "hertz": {"contact": {"law": "hertz"}},
    "smooth jkr": {"contact": {"law": "jkr", "smoothing": "0.2 um"}},
    "exact jkr": {"contact": {"law": "exact-jkr"}},
    "springs": {"contact": {"law": "cubic"}},
    "physicell": {"contact": {"law": "physicell"}},
    "unlike types": TYPES,
    "energies of types": {
        "types": {
            "a": {"surface_energy": {"a": "0.2 nN/um", "b": "0.05 nN/um"}},
            "b": {"surface_energy": {"a": "0.05 nN/um", "b": 0}},
        }
    },
    "bonds": {
        "adhesion": {"strength": "0.05 kPa"},
        "types": {"a": {"receptor": 2, "ligand": [[0, 0], ["10 min", 2]]}, "b": {"ligand": 1}},
    },
    "plane": {"dimensions": 2},
    "growth": {"growth": {"cycle_time": "4 h", "critical_pressure": "0.05 kPa"}},
    "phases": {"growth": {"phases": PHASES}},
    "death": {"death": {"apoptosis_rate": "1e-4 1/s", "lysis_time": "1 h"}},
    "inflow": {"death": {"apoptosis_rate": "1e-4 1/s", "inflow": True}},
    "oxygen": OXYGEN,
    "radial oxygen": {**OXYGEN, "nutrients.oxygen.geometry": "radial"},
    "transient oxygen": {**OXYGEN, "nutrients.oxygen.regime": "transient"},
    "starvation": {**OXYGEN, "nutrients.oxygen.necrosis": "0.045 mM"},
    "finite medium": {
        **OXYGEN,
        "nutrients.oxygen.boundary": 0.05,
        "nutrients.oxygen.finite_medium": {"volume": "0.1 uL"},
    },
    "chemotaxis": {**OXYGEN, "chemotaxis": {"oxygen": {"force": "0.2 nN"}}},
    "radiation": {"radiation": {"beam": {"dose": "4 Gy", "start": 0, "alpha": "0.3 1/Gy"}}},
    "a response": {
        **OXYGEN,
        "growth": {},
        "responses": {
            "slow": {
                "behaviour": "growth", "signal": "oxygen", "law": "hill",
                "half": "0.02 mM", "power": 2,
            }
        },
    },
    "own network": {"networks": {"relax": {"network": relax.name, "divide": {"A": "reset"}}}},
    "network of a file": {**OXYGEN, "networks": {"energy": ENERGY}},
    "network that takes up": {
        **OXYGEN,
        "networks": {"energy": {**ENERGY, "fluxes": {"oxygen": "uptake: Supply"}}},
    },
    "fed by a network": {
        **OXYGEN,
        "growth": {},
        "networks": {"energy": {**ENERGY, "start": "steady", "method": "rodas4"}},
        "responses": {
            "fed": {
                "behaviour": "growth", "signal": "energy.Energy", "law": "hill",
                "half": 12, "power": 4,
            },
            "starved": {
                "behaviour": "apoptosis rate", "signal": "energy.Energy", "law": "hill",
                "half": 5, "power": 2, "falls": True, "largest": "1e-4 1/s",
            },
        },
    },
    "coarse cells": {"cells.represents": 8},
    "no variation": {"cells.young_variation": 0},
    "loose": {"initial.spacing": 1.3},
    "thin medium": {"drag.viscosity": "0.05 kPa s"},
}  # fmt: skip


def composed(rng):
    """Return the entries of a built-in scene with up to four of the parts that fit it."""
    scene = _small(mc.load_scene(str(rng.choice(mc.scene_names()))), rng)
    names = rng.permutation(list(PARTS))[: rng.integers(0, 12)]
    added = 0
    for name in names:
        try:
            scene = scene.with_changes(PARTS[name])
        except SceneError:
            continue  # the scene cannot have it
        added += 1
        if added == 4:
            break
    for method in rng.permutation(list(METHODS)):
        try:
            step = 0.25 * scene.coupling_step
            scene = scene.with_changes(
                {"integrator.method": str(method), "integrator.step": min(step, 10.0)}
            )
        except SceneError:
            continue  # a full Jacobian, which friction makes
        entries = scene.to_dict()
        assert mc.Scene.from_dict(entries) == scene  # only its start may be refused
        return entries
    raise AssertionError("no method holds the scene")


def _small(scene, rng):
    """Return a scene with few cells, few and short coupling steps, and all frames."""
    step = min(scene.coupling_step, 600.0)
    changes = {"coupling_step": step, "output.every": step, "seed": int(rng.integers(1000))}
    changes["duration"] = STEPS * step
    if not scene.motions:  # where cells are named by their places there must be some
        changes["initial.count"] = int(rng.integers(2, CELLS + 1))
    return scene.with_changes(changes)
