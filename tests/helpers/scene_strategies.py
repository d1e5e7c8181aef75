"""Scenes for tests, drawn from the declarations of the package: keys that come later are drawn too.

:func:`plausible` scenes fit together and mostly hold usual numbers; :func:`wild` ones are such
scenes, now and then with numbers from all of their ranges, and with some places broken: other
types, wrong units, numbers at the ends of what there is, unknown keys, tables in place of values.
"""

from __future__ import annotations

import copy
import datetime
import functools
import math
import tempfile
from pathlib import Path

import hypothesis
import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import multicell as mc
from multicell.cells import Phase
from multicell.errors import DataError, SceneError
from multicell.scene.nutrient import FACES
from multicell.scene.parts import CYCLE_PHASES
from multicell.scene.scene import Scene
from multicell.schema import build_part, specs
from multicell.simulation.start_check import check_population
from multicell.units import RANGES

FIELDS = ("oxygen", "glucose", "drug")
TYPES = ("soft", "stiff", "third")
NAMES = {
    "types": TYPES,
    "nutrients": FIELDS,
    "chemotaxis": FIELDS,
    "uptake_on": FIELDS[:1],
    "secretion_from": FIELDS[:1],
    "uptake_of": FIELDS,
    "quiescence_of": FIELDS,
    "necrosis_of": FIELDS,
    "chemotaxis_of": FIELDS,
    "release": ("shot",),
    "yields": FIELDS,
    "secretion_of": FIELDS,
    "surface_energy": TYPES,
    "adhesion_with": TYPES,
    "parameters": ("exponent",),
    "sides": FACES,
    "phases": CYCLE_PHASES,
    "reactions": ("binding", "breakdown"),
    "networks": ("relax",),
    "scales": ("source",),
    "consumes": FIELDS,
    "produces": FIELDS,
    "motions": ("base", "tip"),
    "observables": ("first", "second"),
    "responses": ("kill", "slow", "switch"),
    "drift": ("young", "cycle_time"),
    "radiation": ("course", "boost"),
    "phase_factor": tuple(Phase.__members__),
}
"""Names of the entries of the tables that have named entries."""


def _lost(t, y, u, p, out):
    out[0] = 1e-3 * y[0]


@mc.network(states={"A": 1.0}, inputs={"source": 0.0}, parameters={"k": 2e-4},
            observed=("lost",), observe=_lost, time_unit=None)  # fmt: skip
def relax(t, y, u, p, out):
    """Relax towards an input."""
    out[0] = p[0] * (u[0] - y[0])


TEXTS = {
    "columns": ("", "x=position_x_um um, y=y_um um, z=z_um um"),
    "behaviour": ("growth rate", "rest", "apoptosis rate", "necrosis rate", "damage rate",
                  "entry into S", "speed", "receptors", "Young's modulus", "surface energy",
                  "uptake of oxygen", "change to soft"),
    "signal": (*FIELDS, "pressure", "age", "volume", "time", "neighbours",
               "contacts with soft", "relax.A", "neighbours.relax.A"),
    "cells": TYPES,
    "type": TYPES,
    "towards": FIELDS,
    "oxygen": FIELDS,
    "network": (relax.name,),
    "solver": ("auto", "auto", "multicell-implicit", "multicell-march", "multicell-steady"),
    "initial_formula": ("0.05", "0.02 * exp(-(x**2 + y**2) / 400)"),
    "column": ("", "value"),
    "after": ("age > 20 min", "pressure > 0.01 kPa", "volume > 200", "neighbours < 3"),
}  # fmt: skip
"""Texts that name something, by their keys."""

OF_A_NETWORK = {
    "inputs": ({"source": "oxygen"}, {"source": "time"}, {"source": "neighbours"}),
    "units": ({"A": "mM"},),
    "fluxes": ({"oxygen": "uptake: lost"}, {"oxygen": "secretion: lost"}),
    "divide": ({"A": "reset"}, {"A": "share"}),
}
"""Tables of texts of the network that is drawn, by their keys."""

TOGETHER = {
    "CellNetwork": ("network",),
    "Energy": ("yields quiescence", "yields necrosis", "yields growth_half_saturation"),
    "Response": ("signal law=hill half", "signal law=monod half", "signal law=threshold half",
                 "signal law=monod half falls", "signal law=linear begin end",
                 "signal law=table points", "law=constant largest"),
    "Reaction": ("consumes", "consumes produces"),
    "Motility": ("bias direction", "bias towards", ""),
    "Side": ("type=derivative derivative", "value", ""),
    "Release": ("place", "type"),
    "Domain": ("shape=sphere radius stiffness", "shape=sphere radius", "x y z"),
    "Nutrient": ("uptake", "uptake initial_formula", "uptake initial_file",
                 "uptake_per_volume uptake_on", "uptake_per_volume",
                 "uptake_per_volume geometry=radial layer"),
}  # fmt: skip
"""Keys of parts that mean nothing alone, or exclude each other: one row of them is drawn."""

USUAL = {
    "um": (1.0, 50.0),
    "um^3": (1e9, 1e13),
    "s": (60.0, 1e5),
    "kPa": (0.3, 10.0),
    "nN": (1e-3, 1.0),
    "nN/s": (1e-5, 1e-2),
    "nN/um": (1e-3, 0.2),
    "um/s": (1e-4, 1e-2),
    "kPa s": (0.05, 20.0),
    "kPa s/um": (1e-3, 1.0),
    "um^2/s": (10.0, 3000.0),
    "mM": (1e-3, 0.5),
    "mM/s": (1e-4, 0.02),
    "mM/um": (1e-6, 1e-3),
    "amol/s": (0.1, 50.0),
    "amol": (0.1, 1e4),
    "1/s": (1e-7, 1e-3),
    "Gy": (0.5, 10.0),
    "1/Gy": (0.05, 0.8),
    "1/Gy^2": (0.005, 0.1),
    "": (0.1, 3.0),
}
"""Numbers as scenes have them, by unit; those with a default are drawn round it."""

OTHER_UNITS = {
    "um": ("mm", "nm", "micrometer", "dm"),
    "um^3": ("uL", "mm^3", "nL"),
    "s": ("h", "min", "d", "ms"),
    "kPa": ("Pa", "MPa", "nN/um**2", "nN um^-2"),
    "kPa s": ("Pa s", "kPa*s", "nN s/um^2"),
    "um^2/s": ("mm**2/h", "um*um/s", "cm^2 s^-1"),
    "mM": ("mol/m^3", "uM", "amol/um^3"),
    "amol/s": ("fmol/min", "amol s**-1"),
    "mM/s": ("amol/s/um^3", "mM/min"),
    "1/s": ("1/h", "Hz", "s^-1"),
}
"""Other ways to write a unit, with other factors."""

WILD_NUMBERS = (
    0, -1, 1, 2**31, 2**63 - 1, 2**63, 10**18, -(10**18), 10**400, 0.0, -0.0, 5e-324, 1e-300,
    -1e-300, 1e-30, 1e30, 1e300, -1e300, 1.7976931348623157e308, 0.1, 0.5, 1.5,
    math.nan, math.inf, -math.inf,
)  # fmt: skip
WILD_TEXTS = (
    "", " ", "nan", "inf", "1", "1 um", "1 parsec", "-5 s", "0 s", "1e400 um", "1e-400 um",
    "5 um^2", "5 um^-2147483648", "5 s**9**9**9", "1 degC", "1e5 K/min", "5 kPa s s s",
    "1 h 5 min", "07:32:00", "x" * 5000, "9" * 90 + " um", "é", "µ" * 40, "5 µm", "\u2028", "a\0b",
    "🧫", "1 " + "(" * 39, "5 um/0", "__import__('os')", "jkr", "cvode", "radial", "true", "a.b",
)  # fmt: skip
WILD = (
    *WILD_NUMBERS, *WILD_TEXTS, True, False, None, [], {}, [[]], [[0, 1]], [[0, 1], [0, 2]],
    [["1 h", 1], ["2 h", 5e-324]], [[1, 2, 3]], [None], {"": 1}, {"x": {"y": {"z": 0}}}, {"law": 3},
    {"type": "mixed"}, b"bytes", datetime.date(2026, 1, 1), datetime.time(1, 2),
    datetime.datetime(2026, 1, 1, 1, 2), 1j, {1: 2}, {"a b": {}}, {"type": "value", "value": 1e300},
    [0] * 5000, {f"k{i}": i for i in range(2000)},
)  # fmt: skip


OF_OWN_CODE = {
    "growth.parameters", "networks.*.file", "networks.*.sha256",
    "nutrients.*.initial_file.sha256",
    "output.observables", "output.observables.*.function",
    "output.observables.*.unit", "responses.*.parameters", "growth.phases.*.target_scale",
}  # fmt: skip
"""Keys that need a user's own Python code, or the parameters of a law of growth: none is drawn."""


def declared(part=Scene, path=""):
    """Yield every key that a scene may have as a dotted path, ``*`` for names, and its spec."""
    for name, spec in specs(part).items():
        where = f"{path}{name}"
        yield where, spec
        if spec.parts is not None:
            yield f"{where}.{spec.key}", spec
            for one in spec.parts.values():
                yield from declared(one, f"{where}.")
        elif spec.table is not None:
            yield from declared(spec.table, f"{where}.*." if spec.kind == "tables" else f"{where}.")


def keys_of(entries, part=Scene, path=""):
    """Yield the declared key, as :func:`declared` names it, of everything in a dict of a scene."""
    known = specs(part)
    for name, value in entries.items():
        if name not in known:
            continue
        where, spec = f"{path}{name}", known[name]
        yield where
        if spec.parts is not None:
            yield f"{where}.{spec.key}"
            rest = {key: entry for key, entry in value.items() if key != spec.key}
            yield from keys_of(rest, spec.parts[value[spec.key]], f"{where}.")
        elif spec.kind == "tables":
            for entry in value.values():
                yield from keys_of(entry, spec.table, f"{where}.*.")
        elif spec.table is not None and isinstance(value, dict):
            yield from keys_of(value, spec.table, f"{where}.")


class Drawer:
    """Draws values for declarations.

    ``extreme`` is the part of numbers from all of their range, ``share`` that of optional keys;
    keys of ``wanted``, which :func:`declared` names, are drawn rather than others.
    """

    def __init__(self, draw, extreme, share=0.45, wanted=()):
        self.draw, self.extreme, self.share = draw, extreme, share
        self.wanted = [path.split(".") for path in sorted(wanted)]

    def wants(self, path):
        """Return whether a path is a wanted key or leads to one."""
        keys = path.split(".")
        return any(
            len(keys) <= len(wanted)
            and all(pattern in ("*", key) for pattern, key in zip(wanted, keys, strict=False))
            for wanted in self.wanted
        )

    def rather(self, options, keys):
        """Return the options with wanted keys, ``keys(option)``, or all where none has any."""
        return [x for x in options if any(map(self.wants, keys(x)))] or list(options)

    def chance(self, share):
        return self.draw(st.integers(0, 999)) < 1000 * share

    def one_of(self, options):
        return self.draw(st.sampled_from(list(options)))

    def part(self, part, path):
        """Return a table of a part: its needed keys, and some of the others."""
        entries = {}
        rows = [dict(x.partition("=")[::2] for x in row.split())
                for row in TOGETHER.get(part.__name__, [""])]  # fmt: skip
        row = self.one_of(self.rather(rows, lambda row: [f"{path}{name}" for name in row]))
        for spec, field in ((specs(part)[f.name], f) for f in part.__dataclass_fields__.values()
                            if f.name in specs(part)):  # fmt: skip
            needed = field.default is field.default_factory or field.name in row
            excluded = field.name not in row and any(field.name in other for other in rows)
            share = 0.95 if self.wants(f"{path}{field.name}") else self.share
            if needed or (not excluded and self.chance(share)):
                value = row.get(field.name) or self.value(spec, field, f"{path}{field.name}")
                if value is not None:
                    entries[field.name] = value
        if part is Scene:
            for field in entries.get("nutrients", {}).values():
                _begin(self, field, entries.get("dimensions", 3))
        return fitted(entries, part)

    def value(self, spec, field, path):
        """Return a value that the declaration accepts."""
        make = getattr(self, f"_{spec.kind}", None)
        return None if make is None else make(spec, field, path)

    def _quantity(self, spec, field, path):
        if spec.options and self.chance(0.3):
            return self.one_of(spec.options)
        return self.written(self.size(spec, spec.unit, field.default), spec.unit)

    def _number(self, spec, field, path):
        return self.size(spec, "", field.default)

    def _measure(self, spec, field, path):
        return float(f"{10.0 ** self.draw(st.floats(-8.0, -3.0)):.4g}")

    def _measure_points(self, spec, field, path):
        return [[0.0, 0.1], [self._measure(spec, field, path), 0.5]]

    def _count(self, spec, field, path):
        if path.endswith("cells.frame"):
            return 0  # the only one of the tables that are written
        low, high = int(spec.bounds.at_least), int(spec.bounds.at_most)
        if self.chance(self.extreme):
            return self.one_of([low, high, (low + high) // 2])
        return self.draw(st.integers(low, min(high, low + 20)))

    def _choice(self, spec, field, path):
        return self.one_of(spec.options)

    def _text(self, spec, field, path):
        if path.endswith("initial_file.sha256"):
            return None  # that of the file
        plain = "", "A scene", 'with "quotes" \\ and # and = [x]', "é µ 🧫"
        return self.one_of(TEXTS.get(path.split(".")[-1], plain))

    def _file_path(self, spec, field, path):
        if "initial_file" in path:
            return str(written_field(self.one_of(["plane.npy", "space.npy", "space.csv"])))
        return str(written_table(self.one_of([1, 2, 3, 8])))

    def _flag(self, spec, field, path):
        return self.chance(0.5)

    def _names(self, spec, field, path):
        return [name for name in spec.options if self.chance(0.5)]

    def _table(self, spec, field, path):
        if spec.shorthand and self.chance(0.2):
            short = specs(spec.table)[spec.shorthand]
            if not short.options:
                return self._file_path(short, None, path)
            return self.one_of(short.options)
        return self.part(spec.table, f"{path}.")

    def _variant(self, spec, field, path):
        inside = {name: [f"{path}.{key}" for key in specs(part)]
                  for name, part in spec.parts.items()}  # fmt: skip
        name = self.one_of(self.rather(spec.options, inside.get))
        return {spec.key: name, **(self.part(spec.parts[name], f"{path}.") or {})}

    def _tables(self, spec, field, path):
        names = self.some(spec.options or self.known(path))
        drawn = {name: self.part(spec.table, f"{path}.{name}.") for name in names}
        return {name: entries for name, entries in drawn.items() if entries is not None}

    def _quantities(self, spec, field, path):
        if path.endswith("surface_energy"):  # a symmetric matrix
            return dict.fromkeys(TYPES, 0.05)
        names = self.some(self.known(path))
        if spec.bounds.at_least == 1:  # of reactions, which take whole numbers
            return dict.fromkeys(names, 1)
        return {name: self.written(self.size(spec, spec.unit), spec.unit) for name in names}

    def _texts(self, spec, field, path):
        return dict(self.one_of(OF_A_NETWORK[path.split(".")[-1]]))

    def _drawn_numbers(self, spec, field, path):
        return {"k": self.one_of([1e-4, {"mean": 1e-4, "variation": 0.3}])}

    def _interval(self, spec, field, path):
        if self.chance(self.extreme):
            return [self.one_of([spec.bounds.at_least, 0.0]), spec.bounds.at_most]
        low, high = (20.0 * self.draw(st.integers(2, 4)) for _ in range(2))
        return [self.written(-low, spec.unit), high]  # a box that cubes fill

    def _vector(self, spec, field, path):
        low, high = USUAL[spec.unit]
        parts = [float(f"{self.draw(st.floats(-high, high)):.4g}") for _ in range(3)]
        parts = [part if abs(part) > low else 0.0 for part in parts]
        parts[0] = parts[0] or high
        return [self.written(part, spec.unit) for part in parts]

    def _whole_numbers(self, spec, field, path):
        return self.one_of([[0], [0], [1, 0]])

    def _moments(self, spec, field, path):
        return [self.written(t, "s") for t in self.rising("s")]

    def _course(self, spec, field, path):
        if self.chance(0.5):
            return self.size(spec, "")
        return [[self.written(t, "s"), self.size(spec, "")] for t in self.rising("s")]

    def _schedule(self, spec, field, path):
        return [
            [self.written(t, "s"), self.written(self.size(spec, spec.unit), spec.unit)]
            for t in self.rising("s")
        ]

    def known(self, path):
        """Return the names that a table may have entries for: no field depends on itself."""
        *_, own, key = ["", *path.split(".")]
        return [name for name in NAMES[key] if name != own]

    def some(self, names):
        """Return some of the names, in their order; seldom none."""
        count = self.one_of([0, 1, 1, 2, 2, len(names)])
        return list(names)[:count] if self.chance(0.5) else list(names)[-count:] if count else []

    def rising(self, unit):
        """Return one to three sizes of a unit that rise, perhaps from zero."""
        low, high = USUAL[unit]
        start = self.one_of([0.0, low])
        return [start + k * high / 7 for k in range(self.one_of([1, 2, 3]))]

    def size(self, spec, unit, default=None):
        """Return a number that a declaration accepts, mostly a usual one."""
        ends = spec.bounds
        smallest, largest = RANGES[unit]
        low = max(x for x in (ends.at_least, ends.above, 0.0) if x is not None)
        low = low or smallest
        high = min(x for x in (ends.at_most, ends.below, largest) if x is not None)
        if ends.contain(0.0) and self.chance(0.1):
            return 0.0
        if self.chance(self.extreme):
            share = self.one_of([0.0, 1.0, self.draw(st.floats(0.0, 1.0))])
            value = math.exp(math.log(low) + share * (math.log(high) - math.log(low)))
        else:
            around = isinstance(default, float) and default > 0.0
            least, most = (default / 3.0, default * 3.0) if around else USUAL[unit]
            share = self.draw(st.floats(0.0, 1.0))
            value = least * (most / least) ** share
        value = float(f"{min(max(value, low), high):.4g}")
        while not (ends.contain(value) and smallest * 0.99 <= value <= largest):
            value = 0.5 * (low + high) if value != 0.5 * (low + high) else 0.5 * value
        return value

    def written(self, value, unit):
        """Return a quantity as a number, or as text with one of the ways to write its unit."""
        if not unit or self.chance(0.6):
            return value
        if unit not in OTHER_UNITS or value == 0.0 or self.chance(0.6):
            return f"{value:.6g} {unit}"
        other = self.one_of(OTHER_UNITS[unit])
        return f"{_registry().Quantity(value, unit).to(other).magnitude:.9g} {other}"


@functools.cache
def _registry():
    import pint

    return pint.UnitRegistry()


def base(value):
    """Return a quantity that :meth:`Drawer.written` wrote as a number of base units."""
    if not isinstance(value, str):
        return value
    digits, unit = value.split(" ", 1)
    home = next(u for u, others in {**dict.fromkeys(USUAL, ()), **OTHER_UNITS}.items()
                if unit == u or unit in others)  # fmt: skip
    return float(_registry().Quantity(float(digits), unit).to(home).magnitude)


def fitted(entries, part=Scene):
    """Return entries without what the part refuses, taken out one place after another; or None.

    What is refused for another reason than by name is left as it is: it is a fault to be found.
    """
    made = copy.deepcopy(entries)
    while True:
        try:
            built = build_part(part, copy.deepcopy(made))
            if part is Scene:
                check_population(built)
        except DataError:
            del made["initial"]["cells"]
        except SceneError as error:
            if not _leave_out(made, error.path):
                return None
        except Exception:
            return made
        else:
            return made


def _leave_out(entries, path):
    """Take out what stands at a path, or what should hold it; return whether there is any."""
    found, node = None, entries
    for key in path.split("."):
        if not isinstance(node, dict) or key not in node:
            break
        found, node = (node, key), node[key]
    if found is None and entries.get("duration", 3600.0) != 3600.0:
        entries["duration"] = 3600.0  # which fits to any step
    elif found is not None:
        del found[0][found[1]]
    else:
        return False
    return True


_TABLES = Path(tempfile.mkdtemp(prefix="multicell-starts-"))


def written_table(rows):
    """Write a table of cells that touch; return its path."""
    file = _TABLES / f"{rows}.csv"
    if not file.exists():
        lines = ["# drawn", "position_x_um,y_um,z_um,frame,time_s"]
        lines += [f"{7.0 * (k % 3 - 1)!r},{7.0 * (k // 3 - 1)!r},0,0,0" for k in range(rows)]
        file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return file


def written_field(name):
    """Write values on a grid that a field begins as; return their path."""
    file = _TABLES / name
    if not file.exists():
        values = np.arange(24).reshape(4, 3, 2) / 500
        if file.suffix == ".npy":
            np.save(file, values if name.startswith("space") else values[:, :, 0])
        else:
            lines = [f"x,y,z,value,{','.join(FIELDS)}"]
            for (x, y, z), value in np.ndenumerate(values):
                lines.append(
                    f"{20 * x - 30},{20 * y - 20},{20 * z - 10}" + f",{value}" * (1 + len(FIELDS))
                )
            file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return file


@st.composite
def plausible(draw, extreme=0.004, small=True, share=0.45, wanted=()):
    """Draw the entries of a scene that fits together; ``small``: that runs in a moment."""
    drawer = Drawer(draw, extreme, share, wanted)
    scene = drawer.part(Scene, "") or {"duration": 3600.0}
    # functions of this process, which no scene brings along
    scene.get("output", {}).pop("observables", None)
    if small:
        _make_small(drawer, scene)
    return fitted(scene) or {"duration": 3600.0}


@st.composite
def starting(draw):
    """Draw a scene with what some starts fit into and some do not."""
    count = draw(st.integers(1, 60))
    scene = {"duration": 600.0, "seed": draw(st.integers(0, 99)), "initial": {
        "count": count, "shape": draw(st.sampled_from(["ball", "row"])),
        "spacing": draw(st.sampled_from([0.8, 1.0, 1.3, 400.0])),
        "jitter": draw(st.sampled_from([0.0, 0.2, 3.0, 3000.0])),
        "stage": draw(st.sampled_from(["birth", "uniform"])),
    }}  # fmt: skip
    half = draw(st.floats(10.0, 80.0))
    what = draw(st.sampled_from(["box", "sphere", "motion", "medium", "field", "radial"]))
    if what == "box":
        scene["domain"] = {axis: [-half, half] for axis in "xyz"}
    elif what == "sphere":
        scene["domain"] = {"shape": "sphere", "radius": half}
    elif what == "motion":
        chosen = {"cells": [draw(st.integers(0, 60))]} if half < 40 else {"x": [half - 40.0, half]}
        scene["motions"] = {"base": chosen}
    else:
        field = {"spacing": draw(st.sampled_from([2.0, 10.0])), "margin": half}
        field |= {"geometry": "radial"} if what == "radial" else {}
        if what == "medium":
            field["finite_medium"] = {"volume": 10.0 ** draw(st.floats(5.0, 9.0))}
        scene["nutrients"] = {"oxygen": field}
    return scene


def _begin(drawer, field, dimensions):
    """Let what a field begins as mostly have an effect, and fit to the scene."""
    if not {"initial_file", "initial_formula"} & set(field) or drawer.chance(0.2):
        return
    field["regime"] = "transient"
    part = field.get("initial_file")
    if isinstance(part, dict):
        table = part["file"].endswith(".csv") and dimensions == 3
        name = "space.csv" if table else "space.npy" if dimensions == 3 else "plane.npy"
        part["file"] = str(written_field(name))
        for key in ("x", "y", "z") if table else ("column",):
            part.pop(key, None)


def _make_small(drawer, scene):
    """Let a scene run in a moment; most starts are arranged."""
    if drawer.chance(0.7):
        scene.get("initial", {}).pop("cells", None)
    step = scene["coupling_step"] = drawer.one_of([1.0, 10.0, 60.0, 600.0, 1800.0])
    scene["duration"] = step * drawer.one_of([1.0, 2.0, 2.5, 3.0])
    scene.setdefault("initial", {})["count"] = drawer.one_of([1, 2, 3, 5, 8, 12, 20])
    near = scene["initial"].get("spacing", 0.9)
    scene["initial"]["spacing"] = near if drawer.chance(0.1) else min(max(near, 0.8), 1.3)
    scene.pop("stop_cells", None)
    options = scene.get("integrator")
    if isinstance(options, dict) and "step" in options:
        options["step"] = max(base(options["step"]), 1e-3 * step)
    if not isinstance(options, dict):
        options = scene["integrator"] = {"method": options or "cvode"}
    # hypothesis leans to the first of a list: too few steps is the last one
    options["max_steps"] = drawer.one_of([*[1000] * 31, 1])
    for field in scene.get("nutrients", {}).values():
        field["spacing"] = max(base(field.get("spacing", 8.0)), 4.0)
        field["margin"] = min(base(field.get("margin", 50.0)), 60.0, 12.0 * field["spacing"])
        field["time_tolerance"] = max(field.get("time_tolerance", 1e-2), 1e-3)
    if drawer.chance(0.97):
        _let_steps_be_few(scene, options)
    if "domain" in scene and drawer.chance(0.9):
        scene["initial"]["jitter"] = min(scene["initial"].get("jitter", 0.0), 0.3)
    _loosen(scene)


def _let_steps_be_few(scene, options):
    """Ask no more of a method than it does in a moment: order 1 takes 1 / tolerance steps."""
    radius = base(scene.get("cells", {}).get("division_radius", 5.0))
    first = options.get("method") in ("euler-adaptive", "multirate-euler")
    least = (2e-2 if first else 1e-5) * radius
    options["atol"] = min(max(base(options.get("atol", 0.01)), least), 0.1 * radius)
    options["rtol"] = max(options.get("rtol", 1e-6), 1e-4 if first else 1e-9)
    # a random path of many radii in a step is followed in thousands of pieces, each by itself
    scales = [kind.get("diffusion_scale", 1.0) for kind in scene.get("types", {}).values()]
    motility, most = scene.get("motility", {}), radius**2 / scene["coupling_step"]
    if motility.get("diffusion") is not None:
        motility["diffusion"] = min(base(motility["diffusion"]), most / max([1.0, *scales]))


def _loosen(scene):
    """Let cells stick so little that none is drawn into another."""
    kinds = scene.get("types", {}).values()
    young = [base(kind["young"]) for kind in kinds if "young" in kind]
    softest = min([*young, base(scene.get("cells", {}).get("young", 1.0))])
    if scene.get("contact", {"law": "jkr"})["law"] in ("jkr", "exact-jkr", "physicell"):
        contact = scene.setdefault("contact", {"law": "jkr"})
        contact["surface_energy"] = min(base(contact.get("surface_energy", 0.1)), 0.1 * softest)
        if contact["surface_energy"] < 1e-9:
            contact["surface_energy"] = 0.0
        for kind in kinds:
            if "surface_energy" in kind:
                energy = min(0.05, 0.1 * softest) if softest > 1e-8 else 0.0
                kind["surface_energy"] = dict.fromkeys(kind["surface_energy"], energy)
    if "adhesion" in scene:
        scene["adhesion"]["strength"] = 1e-3 * softest
        if softest < 1e-6:  # no bond is weak enough
            del scene["adhesion"]
            for kind in kinds:
                kind.pop("receptor", None)
                kind.pop("ligand", None)


def look_until(missing, look, examples=20, most=100):
    """Call ``look`` with plausible scenes of any size until no key is ``missing()``.

    Seeds differ each time, and what is missing still is drawn rather than other keys.
    """
    for number in range(most):
        wanted = missing()
        if not wanted:
            return
        share = 0.8 if number == 0 else 0.2
        scenes = plausible(small=False, share=share, wanted=wanted if number else ())
        drawing = given(entries=scenes)(lambda entries: look(entries))
        limits = settings(max_examples=examples, deadline=None, phases=[hypothesis.Phase.generate],
                          suppress_health_check=list(HealthCheck))  # fmt: skip
        hypothesis.seed(number)(limits(drawing))()


@st.composite
def wild(draw):
    """Draw entries with which a scene must either be made or refused by name."""
    extreme = draw(st.sampled_from([0.0, 0.02, 0.1, 0.5]))
    scene = draw(plausible(extreme=extreme, small=draw(st.booleans())))
    for _ in range(draw(st.sampled_from([0, 0, 1, 1, 2, 4]))):
        _break(draw, scene)
    return scene


def _break(draw, scene):
    """Put something else in one place of a scene's entries."""
    node = scene
    while True:
        tables = [value for value in node.values() if isinstance(value, dict) and value]
        if not tables or draw(st.integers(0, 2)) == 0:
            break
        node = draw(st.sampled_from(tables))
    what = draw(st.sampled_from(["value", "value", "value", "drop", "add", "replace"]))
    names = list(node)
    if what == "add" or not names:
        key = draw(st.sampled_from(["x", "", "viscositty", "a.b", "é", "oxygen", "G1", "k" * 300]))
        node[key] = copy.deepcopy(draw(st.sampled_from(WILD)))
    elif what == "drop":
        del node[draw(st.sampled_from(names))]
    else:
        key = draw(st.sampled_from(names))
        value = node[key]
        if what == "value" and isinstance(value, list) and value and isinstance(value[0], list):
            value[-1] = copy.deepcopy(draw(st.sampled_from(WILD)))
        else:
            node[key] = copy.deepcopy(draw(st.sampled_from(WILD)))


@st.composite
def broken_text(draw, text):
    """Draw a text with some places cut, doubled or replaced."""
    for _ in range(draw(st.integers(1, 3))):
        at = draw(st.integers(0, max(len(text) - 1, 0)))
        end = at + draw(st.integers(0, 12))
        filling = draw(st.sampled_from(
            ["", "=", "[", "]", '"', "\n", "[[", "1e999", "\0", "#", "'''", ".", text[at:end] * 2]
        ))  # fmt: skip
        text = text[:at] + filling + text[end:]
    return text
