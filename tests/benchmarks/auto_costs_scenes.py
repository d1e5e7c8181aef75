"""Scenes of auto_costs.py: name -> scene that each starts from, and what is changed of it."""

from __future__ import annotations

from typing import Any

Changes = dict[str, tuple[str, dict[str, Any]]]


def _tuned() -> Changes:
    found: Changes = {}
    waves = {"initial.count": 60, "initial.stage": "uniform", "initial.jitter": 0.02}
    motile = {"motility": {"force": "0.3 nN", "persistence": "10 min"}, "coupling_step": "5 min"}
    for viscosity in (5.0, 0.5, 0.05, 0.005):
        thin = {"drag.viscosity": viscosity}
        found |= {
            f"grow {viscosity:g}": ("grow-2000", thin | {"initial.count": 80, "duration": "12 h"}),
            f"settle {viscosity:g}": (
                "settle",
                thin | {"initial.count": 100, "coupling_step": "5 min", "duration": "1 h"},
            ),
            f"plane {viscosity:g}": (
                "grow-2000",
                thin
                | {"initial.count": 80, "dimensions": 2, "initial.jitter": 0.0, "duration": "6 h"},
            ),
        }
    for viscosity in (5.0, 0.3, 0.02):
        thin = {"drag.viscosity": viscosity}
        found |= {
            f"waves {viscosity:g}": ("growth", waves | thin | {"duration": "24 h"}),
            f"exact {viscosity:g}": (
                "grow-2000",
                thin
                | {
                    "initial.count": 60,
                    "contact": {"law": "exact-jkr", "surface_energy": 0.1},
                    "duration": "3 h",
                },
            ),
            f"hertz {viscosity:g}": (
                "grow-2000",
                thin | {"initial.count": 80, "contact": {"law": "hertz"}, "duration": "6 h"},
            ),
            f"motile {viscosity:g}": (
                "settle",
                motile | thin | {"initial.count": 80, "duration": "2 h"},
            ),
        }
    for viscosity in (1.0, 0.03):
        thin = {"drag.viscosity": viscosity}
        found |= {
            f"friction {viscosity:g}": (
                "grow-2000",
                thin
                | {
                    "initial.count": 60,
                    "friction": {"normal": 0.1, "tangential": 0.05},
                    "duration": "4 h",
                },
            ),
            f"box {viscosity:g}": (
                "growth",
                thin
                | {
                    "initial.count": 80,
                    "initial.stage": "uniform",
                    "duration": "8 h",
                    "domain": {axis: ["-25 um", "25 um"] for axis in "xyz"},
                },
            ),
            f"thousand {viscosity:g}": (
                "grow-2000",
                thin | {"initial.count": 700, "duration": "40 min"},
            ),
        }
    for viscosity in (1.0, 0.03, 5e-4, 5e-5):
        thin = {"drag.viscosity": viscosity, "initial.count": 80}
        found[f"quiet {viscosity:g}"] = (
            "grow-2000",
            thin | {"initial.stage": "birth", "initial.jitter": 0.05, "duration": "1 h"},
        )
    for viscosity in (2.0, 0.2):
        thin = {"drag.viscosity": viscosity, "initial.count": 2000, "stop_cells": None}
        found |= {
            f"2000 {viscosity:g}": (
                "grow-2000",
                thin | {"initial.spacing": 0.9, "duration": "30 min"},
            ),
            f"quiet 2000 {viscosity:g}": (
                "grow-2000",
                thin | {"initial.stage": "birth", "initial.jitter": 0.05, "duration": "30 min"},
            ),
        }
    built_in = (
        "sorting",
        "confined",
        "compression",
        "division-shock",
        "chemotaxis",
        "monolayer",
        "doublet",
        "stiff-inclusions",
    )
    return found | {name: (name, {}) for name in built_in}


TUNED = _tuned()
"""What the model of costs is fitted to."""

UNSEEN: Changes = {
    "120 growing in honey": (
        "grow-2000",
        {"initial.count": 120, "drag.viscosity": 12.0, "growth.cycle_time": "9 h"},
    ),
    "500 growing at 0.15": (
        "grow-2000",
        {"initial.count": 500, "drag.viscosity": 0.15, "initial.spacing": 0.95},
    ),
    "40 soft cells in water": (
        "settle",
        {
            "initial.count": 40,
            "drag.viscosity": 0.002,
            "cells.young": "0.2 kPa",
            "coupling_step": "15 min",
            "duration": "3 h",
        },
    ),
    "runners": (
        "settle",
        {
            "initial.count": 150,
            "motility": {"force": "0.5 nN", "persistence": "20 min"},
            "drag.viscosity": 0.8,
            "coupling_step": "10 min",
            "duration": "2 h",
        },
    ),
    "slab between walls": (
        "growth",
        {
            "initial.count": 60,
            "initial.stage": "uniform",
            "drag.viscosity": 0.1,
            "domain": {
                "x": ["-60 um", "60 um"],
                "y": ["-60 um", "60 um"],
                "z": ["-14 um", "14 um"],
            },
            "duration": "4 h",
        },
    ),
    "plane of springs": (
        "grow-2000",
        {
            "initial.count": 200,
            "dimensions": 2,
            "initial.jitter": 0.0,
            "contact": {"law": "cubic"},
            "drag.viscosity": 0.4,
        },
    ),
    "exact JKR at 0.1": (
        "grow-2000",
        {
            "initial.count": 50,
            "contact": {"law": "exact-jkr", "surface_energy": 0.2},
            "drag.viscosity": 0.1,
        },
    ),
    "rubbing cells": (
        "grow-2000",
        {
            "initial.count": 45,
            "friction": {"normal": 0.02, "tangential": 0.2},
            "drag.viscosity": 0.5,
        },
    ),
    "shaken": (
        "settle",
        {
            "initial.count": 70,
            "motility": {"diffusion": "0.02 um^2/s"},
            "drag.viscosity": 0.05,
            "coupling_step": "2 min",
            "duration": "1 h",
        },
    ),
    "newborn sheet at 0.01": (
        "grow-2000",
        {
            "initial.count": 300,
            "initial.stage": "birth",
            "dimensions": 2,
            "initial.jitter": 0.01,
            "drag.viscosity": 0.01,
        },
    ),
}
"""What was written down after the last fit."""
