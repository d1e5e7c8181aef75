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
    "slab between walls": (
        "growth",
        {
            "initial.count": 60,
            "initial.stage": "uniform",
            "drag.viscosity": 0.1,
            "domain": {
                "x": ["-60 um", "60 um"],
                "y": ["-60 um", "60 um"],
                "z": ["-25 um", "25 um"],
            },
            "duration": "4 h",
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
    "Hertz, long steps": (
        "grow-2000",
        {
            "initial.count": 90,
            "contact": {"law": "hertz"},
            "drag.viscosity": 2.0,
            "coupling_step": "20 min",
            "growth.cycle_time": "12 h",
        },
    ),
    "fast runners in syrup": (
        "settle",
        {
            "initial.count": 200,
            "motility": {"force": "1 nN", "persistence": "5 min"},
            "drag.viscosity": 3.0,
            "coupling_step": "5 min",
            "duration": "1 h",
        },
    ),
    "sticky sheet": (
        "grow-2000",
        {
            "initial.count": 130,
            "dimensions": 2,
            "initial.jitter": 0.0,
            "contact": {"law": "jkr", "surface_energy": 0.3},
            "drag.viscosity": 1.5,
        },
    ),
    "30 stiff cells": (
        "growth",
        {
            "initial.count": 30,
            "initial.stage": "uniform",
            "cells.young": "5 kPa",
            "drag.viscosity": 1.0,
        },
    ),
    "newborn ball at 0.002": (
        "grow-2000",
        {
            "initial.count": 70,
            "initial.stage": "birth",
            "initial.jitter": 0.03,
            "drag.viscosity": 0.002,
        },
    ),
    "compressed at 0.3": ("compression", {"initial.count": 100, "drag.viscosity": 0.3}),
}
"""What was written down after the last fit and the last change of the choice."""
