"""Small scenes that hold all declared keys between them, other values for each, and digests."""

from __future__ import annotations

import hashlib
import re
import warnings
from dataclasses import is_dataclass
from itertools import product

from bits import arrays

import multicell as mc
from multicell.scene.scene import Scene
from multicell.schema import specs

STEP = 600.0
CYCLES = {
    "without phases": {"cycle_time": "3 h", "cycle_variation": 0.2},
    "with phases": {
        "law": "relaxation",
        "parameters": {"target": 1.5},
        "phases": {
            "G1": {
                "duration": "60 min",
                "distribution": "shifted-gamma",
                "variation": 0.3,
                "shift": 0.4,
            },
            "S": {"duration": "40 min", "distribution": "gamma", "variation": 0.3},
            "G2": {"duration": "30 min", "distribution": "gamma", "target_scale": 1.1},
            "M": {"duration": "20 min", "distribution": "gamma", "grows": False},
        },
        "ki67_decay": "20 min",
        "restriction": True,
        "hypertrophy": True,
        "volume_doubling_time": "2 h",
    },
}
REGIMES = {
    "steady": {"regime": "steady", "margin": "40 um", "margin_shape": "box"},
    "transient": {
        "regime": "transient",
        "margin": "40 um",
        "time_tolerance": 0.02,
        "initial": "medium",
        "media": [["15 min", 0.0595]],
        "media_change": "steps",
    },
    "finite medium": {
        "regime": "transient",
        "margin": "40 um",
        "time_tolerance": 0.02,
        "finite_medium": {"volume": "8e6 um^3", "replaced": 0.5},
        "media": [["15 min", 0.0595]],
    },
    "py-pde's solver": {
        "regime": "transient",
        "margin": "40 um",
        "time_tolerance": 0.02,
        "solver": "scipy",
    },
    "shells": {
        "regime": "transient",
        "time_tolerance": 0.02,
        "geometry": "radial",
        "layer": "60 um",
    },
}
METHODS = {
    "euler": {"step": "30 s"},
    "cvode": {"rtol": 1e-5, "atol": "1e-3 um", "max_steps": 5000},
    "euler-adaptive": {"atol": "0.05 um", "max_displacement": 0.3},
}


KEPT = (
    "regime", "margin", "margin_shape", "time_tolerance", "solver", "geometry", "layer", "spacing",
    "height",
)  # fmt: skip


def fields(regime, dimensions):
    """Return four fields with all that a field can have in a regime."""
    shared = {**REGIMES[regime], "spacing": "20 um"}
    if dimensions == 2:
        shared["height"] = "20 um"
    own = {name: value for name, value in shared.items() if name in KEPT}
    return {
        "oxygen": {
            **shared, "diffusion": "900 um^2/s", "diffusion_medium": "1500 um^2/s",
            "boundary": "0.06 mM", "uptake_per_volume": "0.08 mM/s",
            "half_saturation": "0.01 mM", "quiescent_uptake": 0.6,
            "growth_half_saturation": "0.02 mM", "quiescence": "0.056 mM",
            "necrosis": "0.0545 mM", "hypoxia": "0.055 mM", "perfusion": "1e-4 1/s",
            "decay": "1e-5 1/s",
            "uptake_on": {"glucose": {"effect": 0.5, "half": "1 mM"}},
        },
        "glucose": {
            **own, "diffusion": "300 um^2/s", "boundary": "2 mM", "uptake": "60 amol/s",
            "half_saturation": "0.1 mM",
        },
        "waste": {
            **own, "diffusion": "500 um^2/s", "boundary": "0.01 mM", "uptake": "0 amol/s",
            "secretion": "20 amol/s", "secretion_from": {"glucose": 1.5},
            "growth_inhibition": "0.05 mM", "necrosis_above": "0.0105 mM",
        },
        "buffer": {**own, "diffusion": "500 um^2/s", "boundary": "0.01 mM", "uptake": 0},
    }  # fmt: skip


def tissue(dimensions, cycle, regime):
    """Return a scene in which cells grow, divide, rest, change type and die within 40 min."""
    return {
        "title": "trial", "seed": 3, "duration": 4 * STEP, "coupling_step": STEP,
        **({"dimensions": 2} if dimensions == 2 else {}),
        "initial": {"count": 24, "stage": "asynchronous", "spacing": 0.9, "jitter": 0.02},
        "cells": {
            "division_radius": "8 um", "young": "1 kPa", "young_variation": 0.1, "poisson": 0.4,
            "reaction_time": "25 min", "heritable": ["young", "cycle_time"],
            "drift": {"young": 0.1}, "represents": 1,
        },
        "contact": {"law": "jkr", "surface_energy": "0.02 nN/um", "smoothing": "0.1 um"},
        "drag": {"viscosity": "0.5 kPa s"},
        "growth": {**CYCLES[cycle], "critical_pressure": "1 kPa"},
        "death": {
            "necrosis_rate": "5e-4 1/s", "swelling": 1.5, "swelling_time": "10 min",
            "lysis_time": "10 min", "apoptosis_rate": "1e-4 1/s", "apoptosis_time": "8 min",
            "removal_fraction": 0.5, "inflow": False,
        },
        "types": {
            "a": {
                "fraction": 0.5, "receptor": 2.0, "ligand": [[0, 0], ["10 min", 2]],
                "surface_energy": {"a": "0.03 nN/um", "b": "0.02 nN/um"},
                "cycle_scale": 1.1, "uptake_scale": 1.2,
                "secretion_scale": 0.8, "uptake_of": {"oxygen": 1.1},
                "secretion_of": {"waste": 0.9}, "motility_scale": 1.3,
                "division_radius_scale": 1.05, "quiescence_of": {"oxygen": 1.02},
                "necrosis_of": {"oxygen": 0.99},
            },
            "b": {
                "fraction": 0.5, "young": "2 kPa", "ligand": 1.0,
                "surface_energy": {"a": "0.02 nN/um", "b": "0.025 nN/um"},
                **({"volume_doubling_time": "100 min"} if cycle == "with phases" else {}),
            },
        },
        "adhesion": {"strength": "0.05 kPa"},
        "motility": {
            "force": "0.3 nN", "persistence": "5 min", "bias": 0.5, "towards": "oxygen",
        },
        "chemotaxis": {"glucose": {"force": "0.2 nN", "half": "1e-3 mM/um"}},
        "nutrients": fields(regime, dimensions),
        "energy": {
            "yields": {"oxygen": 5.0}, "growth_half_saturation": "0.1 mM/s",
            "quiescence": "0.35 mM/s", "necrosis": "0.34 mM/s",
        },
        "reactions": {
            "burn": {
                "rate": "1e-3 1/s", "consumes": {"waste": 1}, "produces": {"buffer": 1},
                "where": "tissue",
            },
        },
        "responses": {
            "slow": {
                "behaviour": "growth rate", "signal": "oxygen", "law": "hill", "half": "0.05 mM",
                "power": 3.0, "base": 0.2, "largest": 1.0, "cells": "a",
            },
            "eat": {
                "behaviour": "uptake of oxygen", "signal": "glucose", "law": "linear",
                "begin": "1 mM", "end": "3 mM",
            },
            "turn": {
                "behaviour": "change to b", "signal": "age", "law": "table", "cells": "a",
                "points": [["0 h", "1e-4 1/s"], ["3 h", "5e-4 1/s"]],
            },
            "push": {
                "behaviour": "speed", "signal": "waste", "law": "monod",
                "half": "0.01 mM", "falls": True, "combine": "minimum",
            },
            # cells that wait in G2 grow beyond the volume of division, where hypertrophy lets them
            **({"wait": {"behaviour": "entry into M", "law": "constant", "largest": 0.2}}
               if cycle == "with phases" else {}),
        },
        "radiation": {
            "beam": {
                "dose": "3 Gy", "start": "5 min", "every": "10 min", "fractions": 2,
                "alpha": "0.2 1/Gy", "beta": "0.03 1/Gy^2", "oxygen": "oxygen", "oer": 2.5,
                "half_oxygen": "2 kPa", "cells": "a",
                **({"phase_factor": {"G1": 0.7}} if cycle == "with phases" else {}),
            },
            "boost": {
                "dose": "2 Gy", "times": ["12 min"], "alpha": "0.2 1/Gy", "beta": "0.02 1/Gy^2",
                "mitotic_divisions": 1,
            },
        },
        "output": {"every": 2 * STEP},
    }  # fmt: skip


def settling(dimensions, contact, method):
    """Return a scene of mechanics alone: walls, driven cells, friction and forces."""
    flat = dimensions == 2
    box = {axis: [-18.0, 17.0] if flat else [-12.0, 11.0] for axis in ("xy" if flat else "xyz")}
    return {
        **({"dimensions": 2} if flat else {}),
        "seed": 5, "duration": 240.0, "coupling_step": 60.0,
        "initial": {"count": 20, "spacing": 0.85},
        "contact": contact,
        "friction": {"normal": "0.05 kPa s/um", "tangential": "0.02 kPa s/um"},
        "motility": {
            "force": "0.5 nN", "persistence": "2 min", "renewal": "random", "bias": 0.3,
            "direction": [1, 0.5, 0],
        },
        "pull": {"force": "0.05 nN", "rate": "1e-4 nN/s"},
        "motions": {
            "held": {"cells": [0], "begin": 30.0, "end": 100.0, "velocity": [0, 0, 0]},
            "driven": {
                "x": [0.9, 8.7] if flat else [-3.2, 1.9],
                "y": [-9.9, 6.3] if flat else [-2.2, 7.8],
                **({} if flat else {"z": [-5.5, 2.5]}),
                "velocity": [0.002, 0.0, 0.0], "begin": 120.0,
            },
        },
        "domain": {**box, "young": "3 kPa", "poisson": 0.3},
        "integrator": {"method": method, **METHODS[method]},
        "output": {"every": 120.0},
    }  # fmt: skip


LAWS = {
    "hertz": {},
    "jkr": {"surface_energy": "0.05 nN/um", "smoothing": "0.1 um"},
    "exact-jkr": {"surface_energy": "0.05 nN/um"},
    "linear": {"stiffness_at_rest": "1 nN/um", "cutoff": 1.4},
    "cubic": {"stiffness_at_rest": "1 nN/um", "cutoff": 1.4},
    "generalised-linear": {"stiffness_at_rest": "1 nN/um", "cutoff": 1.4, "decay": 4.0},
    "physicell": {"length": "2 um", "surface_energy": "0.3 nN/um", "cutoff": 1.3},
}


def special():
    """Yield scenes for the parts that others exclude."""
    scene = tissue(3, "without phases", "transient")
    del scene["death"]["necrosis_rate"]
    scene["death"] |= {
        "damage_time": "15 min", "damage_variation": 0.5, "repair_rate": "2e-4 1/s",
    }  # fmt: skip
    yield "damage", scene
    scene = tissue(3, "without phases", "steady")
    del scene["nutrients"]["oxygen"]["necrosis"]
    scene["nutrients"]["oxygen"]["relative"] = {"necrosis": {"to": "quiescence", "factor": 0.97}}
    yield "relative", scene
    yield "drifting", {
        "seed": 2, "duration": 240.0, "coupling_step": 60.0, "initial": {"count": 20},
        "contact": {"law": "hertz"},
        "types": {
            "a": {"fraction": 0.5, "diffusion_scale": 2.0, "chemotaxis_of": {"guide": -2.0}},
            "b": {"fraction": 0.5},
        },
        "motility": {"diffusion": "0.02 um^2/s", "diffusion_step": "20 s"},
        "chemotaxis": {"guide": {"force": "0.2 nN", "half": "1e-3 mM/um"}},
        "domain": {axis: [-20.0, 20.0] for axis in "xyz"} | {"periodic": ["x", "y"]},
        "nutrients": {"guide": {
            "diffusion": "50 um^2/s", "boundary": "0.1 mM", "spacing": "5 um", "uptake": 0,
            "secretion": "5 amol/s", "regime": "steady",
        }, "drop": {
            "diffusion": "0.5 um^2/s", "boundary": "0.1 mM", "spacing": "5 um",
            "uptake": "2 amol/s", "initial_formula": "0.1 * step(x)",
            "release": {
                "there": {"amount": "40 amol", "time": "90 s", "place": [3, 2, 1], "radius": 4.0},
                "cells": {"amount": "20 amol", "time": "60 s", "type": "a"},
            },
        }},
    }  # fmt: skip
    growing = {name: scene[name] for name in ("duration", "coupling_step", "initial", "growth")}
    pressed = {**growing["growth"], "critical_pressure": "0.05 kPa"}
    chosen = {**growing, "growth": pressed, "coupling_tolerance": 1e-6}
    yield "chosen steps", {**chosen, "contact": {"law": "hertz"}}
    yield "stop", {**growing, "contact": {"law": "hertz"}, "stop_cells": 31}
    phases = {name: {"duration": "30 min"} for name in ("G1", "S", "G2", "M")}
    phases["S"]["after"] = "age > 20 min"
    waiting = {**growing, "growth": {"phases": phases}, "contact": {"law": "hertz"}}
    yield "a phase after a condition", waiting
    loose = {"contact": {"law": "hertz"}, "initial": {"count": 6, "spacing": 0.8}}
    yield "plane", {"duration": 120.0, "coupling_step": 60.0, "dimensions": 2, **loose}
    kinds = {
        "a": {"fraction": 0.5, "adhesion_with": {"a": 1.2, "b": 0.5}},
        "b": {"fraction": 0.5, "adhesion_with": {"b": 0.8}},
    }
    sticky = {**loose, "contact": {"law": "jkr"}, "types": kinds}
    yield "adhesion of pairs", {"duration": 120.0, "coupling_step": 60.0, **sticky}
    scene = settling(3, {"law": "jkr"}, "euler")
    for name in ("domain", "friction", "pull", "motions"):
        del scene[name]
    scene["initial"] |= {"shape": "ball", "jitter": 0.02}
    scene["integrator"] = {"method": "rk4-adaptive"}
    scene["surface"] = {"tension": "0.5 nN/um"}
    yield "surface", scene
    squeezed = {**scene, "compression": {"bulk_modulus": "20 kPa", "onset": 0.9}}
    del squeezed["surface"]
    squeezed["initial"] = {"count": 40, "spacing": 0.7}
    yield "compression", squeezed
    kinds = {"a": {"fraction": 0.5}, "b": {"fraction": 0.5, "young": "2 kPa"}}
    driven = {"m": {"type": "a", "velocity": [0.002, 0.0, 0.0]}}
    yield "driven types", {**scene, "surface": {"tension": 0.1}, "types": kinds, "motions": driven}
    gel = {"shape": "sphere", "radius": "14 um", "stiffness": "20 kPa", "poisson": 0.3}
    yield "gel", {**scene, "surface": {"tension": 0.1}, "domain": gel}
    sides = {
        "x-": {"type": "value", "value": "0.05 mM"},
        "x+": {"type": "derivative", "derivative": "1e-4 mM/um"},
    }
    box = {axis: [-60.0, 60.0] for axis in "xyz"}
    field = {"boundary": "0.06 mM", "uptake": "50 amol/s", "sides": sides, "spacing": "15 um"}
    del scene["surface"]
    yield "sides of a box", {**scene, "domain": box, "nutrients": {"oxygen": field}}


def bases():
    """Yield names and entries of the scenes, in which each key is tried."""
    for dimensions, cycle, regime in product((3, 2), CYCLES, REGIMES):
        if regime != "shells" or dimensions == 3:
            yield f"{dimensions}D, {cycle}, {regime}", tissue(dimensions, cycle, regime)
    for dimensions, law in product((3, 2), LAWS):
        scene = settling(dimensions, {"law": law, **LAWS[law]}, "euler")
        yield f"{dimensions}D, {law}", scene
    for dimensions, method in product((3, 2), METHODS):
        scene = settling(dimensions, {"law": "hertz"}, method)
        del scene["friction"]
        yield f"{dimensions}D, {method}", scene
    yield from special()


def keys_of(entries):
    """Yield the pattern of each key that entries state, its path, value and declaration.

    Names of fields, types and other entries are stars in the pattern; laws stand in brackets.
    """
    known = set(_stated(entries))
    for pattern, path, value, spec in _keys(Scene.from_dict(entries), "", ""):
        if any(f"{key}.".startswith(f"{path}.") for key in known):
            yield pattern, path, value, spec


def _stated(entries, path=""):
    for name, value in entries.items():
        if isinstance(value, dict):
            yield from _stated(value, f"{path}{name}.")
        else:
            yield f"{path}{name}"


def _keys(part, pattern, path):
    for name, spec in specs(part).items():
        value = getattr(part, name)
        here, there = f"{pattern}{name}", f"{path}{name}"
        if spec.kind == "tables":
            for entry, inner in (value or {}).items():
                yield from _keys(inner, f"{here}.*.", f"{there}.{entry}.")
        elif spec.kind == "variant":
            law = next(key for key, kind in spec.parts.items() if type(value) is kind)
            yield here, f"{there}.{spec.key}", law, spec
            yield from _keys(value, f"{here}[{law}].", f"{there}.")
        elif is_dataclass(value):
            yield from _keys(value, f"{here}.", f"{there}.")
        elif value is not None and spec.kind not in ("table", "tables"):
            yield here, there, value, spec


def declared(part=Scene, pattern=""):
    """Yield the patterns of all keys that are declared."""
    for name, spec in specs(part).items():
        here = f"{pattern}{name}"
        if spec.kind in ("table", "tables"):
            stars = "" if spec.kind == "table" else "*."
            yield from declared(spec.table, f"{here}.{stars}")
        elif spec.kind == "variant":
            yield here
            for law, kind in spec.parts.items():
                yield from declared(kind, f"{here}[{law}].")
        else:
            yield here


TEXTS = {
    "growth.phases.*.after": ["age > 5 min"],
    "motility.towards": ["glucose"],
    "motions.*.type": ["b"],
    "radiation.*.cells": ["b"],
    "radiation.*.oxygen": ["waste"],
    "nutrients.*.initial_formula": ["0.2"],
    "nutrients.*.release.*.type": ["b"],
    "responses.*.behaviour": ["rest", "speed", "growth rate"],
    "responses.*.cells": ["b"],
    "responses.*.signal": ["waste", "glucose", "oxygen"],
}
"""Other values of keys that name something."""

FAR = {
    "coupling_tolerance": [0.1],
    "types.*.necrosis_of": [{"oxygen": 1.045}],
    "radiation.*.phase_factor": [{"G1": 9.0}],
}
"""Values far from those of the scenes, for keys by which chances of few cells change."""


def others(pattern, value, spec):
    """Yield values within the range of a key that are not its own."""
    yield from (text for text in TEXTS.get(pattern, ()) if text != value)
    yield from FAR.get(pattern, ())
    yield from _others(value, spec)


def _others(value, spec):
    if spec.kind == "flag":
        yield not value
    elif spec.kind in ("choice", "variant"):
        yield from (option for option in spec.options if option != value)
    elif spec.kind == "names":
        yield from (value[:place] + value[place + 1 :] for place in range(len(value)))
    elif isinstance(value, bool | str | None):
        return
    elif isinstance(value, int):
        yield from (value + 1, value - 1)
    elif isinstance(value, float):
        yield from (value * 1.3, value * 0.7, value * 1.05) if value else (0.1, 1e-3, 1.0)
    elif isinstance(value, dict) or hasattr(value, "items"):
        for name, number in value.items():
            yield {**value, name: number * 1.3 if number else 0.1}
    elif isinstance(value, tuple):
        for place, entry in enumerate(value):
            for other in _others(entry, spec):
                yield [*value[:place], other, *value[place + 1 :]]


def digest(scene):
    """Return a digest of all that a run gives: its frames, history and key numbers."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        result = mc.run(scene, threads=1)
    found = hashlib.sha256()
    for frame in result.frames:
        found.update(f"{frame.time} {frame.step}".encode())
        for name, values in arrays(frame):
            found.update(f"{name} {values.shape}".encode())
            found.update(values.tobytes())
    for name, column in sorted(result.history.items()):
        if not re.match("wall|compile|evaluations|stability|shift", name):
            found.update(name.encode())
            found.update(column.tobytes())
    return found.hexdigest()
