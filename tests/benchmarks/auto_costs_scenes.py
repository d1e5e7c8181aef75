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
    "32 stiff cells": (
        "grow-2000",
        {
            "initial.count": 32,
            "drag.viscosity": 0.14,
            "contact.surface_energy": 0.043,
            "cells.young": "2.7 kPa",
        },
    ),
    "80 soft cells": (
        "grow-2000",
        {
            "initial.count": 80,
            "drag.viscosity": 0.067,
            "coupling_step": "5 min",
            "contact.surface_energy": 0.047,
            "cells.young": "0.32 kPa",
        },
    ),
    "sheet at 0.025": (
        "grow-2000",
        {
            "initial.count": 91,
            "dimensions": 2,
            "initial.jitter": 0.0,
            "drag.viscosity": 0.025,
            "coupling_step": "5 min",
        },
    ),
    "waves at 4.7": (
        "growth",
        {
            "initial.count": 112,
            "initial.stage": "uniform",
            "initial.jitter": 0.02,
            "drag.viscosity": 4.7,
            "coupling_step": "2 min",
            "duration": "4 h",
        },
    ),
    "exact JKR at 3.2": (
        "grow-2000",
        {
            "initial.count": 36,
            "contact": {"law": "exact-jkr", "surface_energy": 0.03},
            "drag.viscosity": 3.2,
            "coupling_step": "20 min",
        },
    ),
    "runners at 0.014": (
        "settle",
        {
            "initial.count": 80,
            "motility": {"force": "0.2 nN", "persistence": "15 min"},
            "drag.viscosity": 0.014,
            "coupling_step": "20 min",
            "duration": "8 h",
        },
    ),
    "Hertz at 0.58": (
        "grow-2000",
        {"initial.count": 92, "contact": {"law": "hertz"}, "drag.viscosity": 0.58},
    ),
    "box at 0.013": (
        "growth",
        {
            "initial.count": 104,
            "initial.stage": "uniform",
            "drag.viscosity": 0.013,
            "duration": "4 h",
            "domain": {axis: ["-28 um", "28 um"] for axis in "xyz"},
        },
    ),
    "sticky, 2 min": (
        "settle",
        {
            "initial.count": 106,
            "drag.viscosity": 0.41,
            "contact.surface_energy": 0.25,
            "coupling_step": "2 min",
            "duration": "1 h",
        },
    ),
    "newborn at 1.1": (
        "grow-2000",
        {
            "initial.count": 50,
            "initial.stage": "birth",
            "initial.jitter": 0.03,
            "cells.young": "1.8 kPa",
            "drag.viscosity": 1.1,
        },
    ),
}
"""What was drawn after the last fit. Of all but ``box at 0.013``, ``runners at 0.014`` and ``80
soft cells`` results were known before the last change of the choice, CVODE's part of the tolerance.
"""
