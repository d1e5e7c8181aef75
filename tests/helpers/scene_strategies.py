"""Scenes for tests, drawn from the declarations of the package: keys that come later are drawn too.

:func:`plausible` scenes fit together and mostly hold usual numbers; :func:`wild` ones are such
scenes, now and then with numbers from all of their ranges, and with some places broken: other
types, wrong units, numbers at the ends of what there is, unknown keys, tables in place of values.
"""

from __future__ import annotations

import copy
import datetime
import functools
import hashlib
import math
import tempfile
from pathlib import Path

import hypothesis
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from multicell.cells import Phase
from multicell.integrators.registry import METHODS
from multicell.scene.nutrient import FACES
from multicell.scene.parts import PHASES
from multicell.scene.scene import Scene
from multicell.schema import specs
from multicell.units import RANGES

FIELDS = ("oxygen", "glucose", "drug")
TYPES = ("soft", "stiff", "third")
NAMES = {
    "types": TYPES,
    "nutrients": FIELDS,
    "chemotaxis": FIELDS,
    "uptake_on": FIELDS,
    "secretion_from": FIELDS,
    "receptor_by": FIELDS,
    "ligand_by": FIELDS,
    "uptake_of": FIELDS,
    "yields": FIELDS,
    "secretion_of": FIELDS,
    "surface_energy": TYPES,
    "parameters": ("exponent",),
    "sides": FACES,
    "phases": PHASES,
    "sources": ("pump", "dish"),
    "regions": ("gel", "wall"),
    "reactions": ("binding", "breakdown"),
    "consumes": FIELDS,
    "produces": FIELDS,
    "activated_by": FIELDS,
    "inhibited_by": FIELDS,
    "forces": ("tug", "weight"),
    "motions": ("base", "tip"),
    "observables": ("first", "second"),
    "responses": ("kill", "slow", "switch"),
    "signals": ("stress", "food"),
    "drift": ("young", "cycle_time"),
    "of": (*FIELDS, "pressure", "age", "neighbours"),
    "radiation": ("course", "boost"),
    "phase_factor": tuple(Phase.__members__),
}
"""Names of the entries of the tables that have named entries."""

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
    "amol/s/um^2": (1e-5, 1e-2),
    "1/s": (1e-7, 1e-3),
    "1/um": (1e-3, 1.0),
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
    "growth.parameters", "output.observables", "output.observables.*.function",
    "output.observables.*.unit", "responses.*.parameters",
}  # fmt: skip
"""Keys that mean a user's own Python code, without which no scene with them is made."""


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
    """Draws values for declarations; ``extreme`` is the part of numbers from all of their range."""

    def __init__(self, draw, extreme):
        self.draw, self.extreme = draw, extreme

    def chance(self, share):
        return self.draw(st.integers(0, 999)) < 1000 * share

    def one_of(self, options):
        return self.draw(st.sampled_from(list(options)))

    def part(self, part, path):
        """Return a table of a part: its needed keys, and some of the others."""
        entries = {}
        for spec, field in ((specs(part)[f.name], f) for f in part.__dataclass_fields__.values()
                            if f.name in specs(part)):  # fmt: skip
            needed = field.default is field.default_factory  # both are missing
            if needed or self.chance(0.45):
                value = self.value(spec, field, f"{path}{field.name}")
                if value is not None:
                    entries[field.name] = value
        return entries

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

    def _count(self, spec, field, path):
        low, high = int(spec.bounds.at_least), int(spec.bounds.at_most)
        if self.chance(self.extreme):
            return self.one_of([low, high, (low + high) // 2])
        return self.draw(st.integers(low, min(high, low + 20)))

    def _choice(self, spec, field, path):
        return self.one_of(spec.options)

    def _text(self, spec, field, path):
        return self.one_of(["", "A scene", 'with "quotes" \\ and # and = [x]', "é µ 🧫"])

    def _file_path(self, spec, field, path):
        # how many rows the table has that _fit_start writes
        return self.one_of(["1", "2", "3", "8"])

    def _flag(self, spec, field, path):
        return self.chance(0.5)

    def _names(self, spec, field, path):
        return [name for name in spec.options if self.chance(0.5)]

    def _table(self, spec, field, path):
        if spec.shorthand and self.chance(0.2):
            short = specs(spec.table)[spec.shorthand]
            return self.one_of(short.options or self._file_path(short, None, path))
        return self.part(spec.table, f"{path}.")

    def _variant(self, spec, field, path):
        name = self.one_of(spec.options)
        return {spec.key: name, **self.part(spec.parts[name], f"{path}.")}

    def _tables(self, spec, field, path):
        names = self.some(spec.options or NAMES[path.split(".")[-1]])
        return {name: self.part(spec.table, f"{path}.{name}.") for name in names}

    def _quantities(self, spec, field, path):
        names = self.some(NAMES[path.split(".")[-1]])
        return {name: self.written(self.size(spec, spec.unit), spec.unit) for name in names}

    def _responses(self, spec, field, path):
        names = self.some(NAMES[path.split(".")[-1]])
        return {name: [[x, self.size(spec, "")] for x in self.rising(spec.unit)] for name in names}

    def _interval(self, spec, field, path):
        least, most = USUAL[spec.unit]
        if self.chance(self.extreme):
            return [self.one_of([spec.bounds.at_least, 0.0]), spec.bounds.at_most]
        low, high = (self.draw(st.floats(least, most)) for _ in range(2))
        return [self.written(float(f"{-low:.4g}"), spec.unit), float(f"{high:.4g}")]

    def _vector(self, spec, field, path):
        low, high = USUAL[spec.unit]
        parts = [float(f"{self.draw(st.floats(-high, high)):.4g}") for _ in range(3)]
        parts = [part if abs(part) > low else 0.0 for part in parts]
        parts[0] = parts[0] or high
        return [self.written(part, spec.unit) for part in parts]

    def _whole_numbers(self, spec, field, path):
        return self.one_of([[0], [0, 1], [3, 1, 2]])

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


def fitted(entries):
    """Return a scene's entries without what does not fit to the rest (the checks of a scene)."""
    scene = copy.deepcopy(entries)
    flat = scene.get("dimensions", 3) == 2
    fields, types = scene.get("nutrients", {}), scene.get("types", {})
    _fit_cells(scene)
    _fit_domain(scene, flat)
    _fit_death(scene)
    if flat:
        scene.pop("compression", None)
    _fit_start(scene)
    _fit_growth(scene)
    _fit_driven(scene, flat)
    _fit_motility(scene, flat)
    _fit_types(scene, types, fields)
    if flat and any(_takes_up(x) and not base(x.get("perfusion", 0.0)) for x in fields.values()):
        for field in fields.values():
            field.setdefault("height", 10.0)
    _fit_reactions(scene, fields)
    for number, (name, field) in enumerate(fields.items()):
        _fit_field(scene, field, list(fields)[:number], fields, flat)
        assert name in fields
    _fit_energy(scene, fields)
    _fit_radiation(scene, types, fields)
    scene["chemotaxis"] = {n: x for n, x in scene.get("chemotaxis", {}).items() if n in fields}
    if flat:
        scene.pop("surface", None)
    if flat and scene.get("haptotaxis", {}).get("axis") == "z":
        scene["haptotaxis"]["axis"] = "y"
    _fit_responses(scene, list(fields), list(types))
    # functions of this process, which no scene brings along
    scene.get("output", {}).pop("observables", None)
    return scene


def _fit_radiation(scene, types, fields):
    """Let courses have times, and name fields, types and phases that there are."""
    growth = scene.get("growth")
    for course in scene.get("radiation", {}).values():
        course.setdefault("beta", 0.03)
        if not base(course["alpha"]):
            course["alpha"] = 0.3
        if "times" in course:
            course.pop("start", None)
            course.pop("fractions", None)
        else:
            course.setdefault("start", 0.0)
        for key, known in (("cells", types), ("oxygen", fields)):
            if key in course:
                course[key] = next(iter(known), "")
        if growth is None:
            course.pop("mitotic_divisions", None)
        if not (growth or {}).get("phases"):
            course.pop("phase_factor", None)


def _fit_reactions(scene, fields):
    """Keep reactions between fields that there are, and give these one grid and no circles."""
    kept = {}
    for name, reaction in scene.get("reactions", {}).items() if fields else ():
        for key in ("consumes", "produces", "activated_by", "inhibited_by"):
            entries = reaction.get(key, {}).items()
            reaction[key] = {n if n in fields else next(iter(fields)): x for n, x in entries}
        # of whole numbers, and no more made than used: nothing grows without bound
        reaction["consumes"] = dict.fromkeys(reaction["consumes"], 1)
        made = list(reaction["produces"])[: max(len(reaction["consumes"]), 1)]
        reaction["produces"] = dict.fromkeys(made, 1)
        hill = reaction["activated_by"] or reaction["inhibited_by"]
        reaction["kind"] = "hill" if hill else "mass-action"
        if hill:
            for field in reaction["consumes"]:
                reaction["activated_by"].setdefault(field, {"half": 0.05})
        else:
            del reaction["activated_by"], reaction["inhibited_by"]
        if reaction["consumes"].keys() == reaction["produces"].keys():
            reaction["produces"] = {}
        if reaction["consumes"] or reaction["produces"]:
            kept[name] = reaction
    scene.pop("reactions", None)
    if not kept:
        return
    scene["reactions"] = kept
    keys = ("consumes", "produces", "activated_by", "inhibited_by")
    joined = {name for x in kept.values() for key in keys for name in x.get(key, {})}
    reacting = [field for name, field in fields.items() if name in joined]
    first = reacting[0]
    for field in reacting:
        for key in ("uptake_on", "secretion_from", "regime", "initial"):
            field.pop(key, None)
        for key in ("margin", "roundness_limit", "height", "spacing", "geometry", "layer"):
            if key in first:
                field[key] = first[key]
            else:
                field.pop(key, None)


def _fit_cells(scene):
    cells = scene.get("cells", {})
    if cells.get("poisson", 0.5) > 0.5:
        cells["allow_unphysical_poisson"] = True
    contact = scene.get("contact", {})
    radius = 0.79 * base(cells.get("division_radius", 5.0))
    if "smoothing" in contact and base(contact["smoothing"]) > radius:
        contact["smoothing"] = 0.0


def _fit_domain(scene, flat):
    """Let the box hold the cells, and let cubes fill it."""
    domain = scene.get("domain")
    if domain is None:
        return
    if domain.get("wall") == "refuse":
        domain.pop("young", None)
        domain.pop("poisson", None)
    radius = base(scene.get("cells", {}).get("division_radius", 5.0))
    unit = 2.0 * radius
    sphere = domain.get("shape") == "sphere"
    if not sphere or flat or domain.get("wall") == "refuse":
        domain.pop("stiffness", None)
    domain.pop("radius", None)
    if sphere:
        scene["domain"] = {k: v for k, v in domain.items() if k not in "xyz"}
        scene["domain"]["radius"] = 8.0 * unit
        return
    if 8.0 * unit > RANGES["um"][1]:
        del scene["domain"]
        return
    for axis in "xyz":
        low, high = (base(end) for end in domain.pop(axis, [-radius, radius]))
        if axis == "z" and flat:
            continue
        ends = (max(4, min(math.ceil(abs(end) / unit), 8)) for end in (low, high))
        domain[axis] = [sign * unit * count for sign, count in zip((-1, 1), ends, strict=True)]


def _fit_death(scene):
    """Leave out the second law of the same death, and inflow where walls forbid it."""
    death = scene.get("death", {})
    if "damage_time" in death:
        death.pop("necrosis_rate", None)
    if "domain" in scene:
        death.pop("inflow", None)


def _fit_driven(scene, flat):
    """Let drivers name cells that there are, and not move them far, nor two of them the same."""
    count, types = scene.get("initial", {}).get("count", 1), scene.get("types", {})
    drivers = [*scene.get("forces", {}).values(), *scene.get("motions", {}).values()]
    for driver in drivers:
        if "cells" in driver:
            driver["cells"] = [i for i in driver["cells"] if i < count] or [0]
        if "type" in driver and types:
            driver["type"] = next(iter(types))
        else:
            driver.pop("type", None)
        for axis in "xyz":
            if axis in driver:
                driver[axis] = [-1e5, "100 mm"]
        if flat:
            driver.pop("z", None)
        if "end" in driver:
            driver["begin"] = min(base(driver.get("begin", 0.0)), 1e11)
            driver["end"] = driver["begin"] + min(base(driver["end"]), 1e11)
        for key in {"force", "rate", "velocity"} & driver.keys():
            driver[key] = [base(part) for part in driver[key]]
            driver[key][2] *= not flat
    if scene.get("types") and any("type" in driver for driver in drivers):
        # with a region or identities besides it might name no cell
        for driver in drivers:
            if "type" in driver:
                for key in ("cells", *"xyz"):
                    driver.pop(key, None)
    for force in scene.get("forces", {}).values():
        if "rate" not in force:
            force.setdefault("force", [0.1, 0.0, 0.0])
    motions = scene.get("motions", {})
    for name in list(motions)[1:]:
        del motions[name]
    step = scene.get("coupling_step", 600.0)
    longest = 3600.0 if step == "auto" else base(step)
    radius = base(scene.get("cells", {}).get("division_radius", 5.0))
    for motion in motions.values():
        if "velocity" in motion:
            size = math.hypot(*motion["velocity"])
            share = min(1.0, 0.1 * radius / longest / size)
            motion["velocity"] = [share * part for part in motion["velocity"]]


def _fit_motility(scene, flat):
    """Let a bias be along something, and nothing be given without one."""
    law = scene.get("motility", {})
    fields = list(scene.get("nutrients", {}))
    if not law.get("bias"):
        for key in ("direction", "towards"):
            law.pop(key, None)
    elif "towards" in law and fields:
        law["towards"] = fields[-1]
        law.pop("direction", None)
    else:
        law.pop("towards", None)
        law["direction"] = [1.0, -2.0, 0.0 if flat else 0.5]


_TABLES = Path(tempfile.mkdtemp(prefix="multicell-starts-"))
_ARRANGED = ("count", "shape", "spacing", "jitter")


def _fit_start(scene):
    """Write the table that a start names, and drop the keys that it leaves without effect."""
    initial = scene.get("initial", {})
    if "cells" in initial:
        for key in _ARRANGED:
            initial.pop(key, None)
        named = initial["cells"]
        rows = int(named if isinstance(named, str) else named["file"])
        radius = base(scene.get("cells", {}).get("division_radius", 5.0))
        file = written_table(rows, radius, bool(scene.get("types")) and rows > 1)
        if isinstance(named, str):
            initial["cells"] = str(file)
            return
        named["file"] = str(file)
        if "rows" in named:
            named["rows"] = rows
        if "sha256" in named:
            named["sha256"] = hashlib.sha256(file.read_bytes()).hexdigest()
        return


def written_table(rows, radius, named):
    """Write a table of cells that touch, whose size is that of half-grown ones; return its path."""
    digits = f"{rows}-{radius:.17g}-{named}"
    file = _TABLES / f"{digits}.csv"
    if not file.exists():
        lines = ["# drawn", "position_x_um,y_um,z_um,radius_um" + ",kind" * named]
        for k in range(rows):
            apart = min(1.5 * radius, 1e6)  # the largest coordinate of a table
            x, y = apart * (k % 3 - 1), apart * (k // 3 - 1)
            lines.append(f"{x!r},{y!r},0,{0.9 * radius!r}" + ",0" * named)
        file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return file


def _fit_growth(scene):
    growth = scene.get("growth")
    if growth is None:
        return
    growth.pop("parameters", None)  # of laws of the user's own
    if growth.get("law", "linear") in ("linear", "exponential"):
        growth.pop("target", None)
    else:
        growth["target"] = max(growth.get("target", 1.3), 1.001)
    phases = growth.get("phases", {})
    if phases:
        for name in PHASES:
            phases.setdefault(name, {"duration": 7200.0})
        if not any(phase.get("grows", True) for phase in phases.values()):
            phases["G1"]["grows"] = True
        for phase in phases.values():
            if phase.get("distribution") == "normal":
                phase["variation"] = min(phase.get("variation", 0.2), 0.5)
        growth["phases"] = {name: phases[name] for name in PHASES}
    else:
        growth.pop("division", None)
    step = scene.get("coupling_step", 600.0)
    if base(step) > _quickest_cycle(scene):
        scene["growth"], scene["coupling_step"] = {}, 600.0
        for kind in scene.get("types", {}).values():
            kind.pop("cycle_scale", None)


def _quickest_cycle(scene):
    """Return the mean cycle of the quickest type, s."""
    growth = scene.get("growth", {})
    phases = growth.get("phases", {}).values()
    cycle = sum(base(phase["duration"]) for phase in phases)
    if not phases:
        cycle = base(growth.get("cycle_time", 54000.0))
    scales = [kind.get("cycle_scale", 1.0) for kind in scene.get("types", {}).values()]
    return cycle * min(scales, default=1.0)


def _fit_types(scene, types, fields):
    sticky = scene.get("contact", {"law": "jkr"})["law"] in ("jkr", "exact-jkr")
    given = sticky and any("surface_energy" in kind for kind in types.values())
    for number, kind in enumerate(types.values()):
        if number == 0:
            kind["fraction"] = 1.0
        kind.pop("surface_energy", None)
        if given:
            kind["surface_energy"] = dict.fromkeys(types, 0.05 + 0.01 * len(types))
        for key in ("receptor_by", "ligand_by", "uptake_of", "secretion_of"):
            if key in kind:
                kind[key] = {name: x for name, x in kind[key].items() if name in fields}
        if "adhesion" not in scene:
            kind.pop("receptor", None)
            kind.pop("ligand", None)
    if "adhesion" in scene:
        if types:
            next(iter(types.values()))["receptor"] = 1.0
        else:
            del scene["adhesion"]


def _takes_up(field):
    return base(field.get("uptake_per_volume", field.get("uptake", 20.0))) > 0.0


def _fit_field(scene, field, earlier, fields, flat):
    for key in ("uptake_on", "secretion_from"):
        if key in field:
            field[key] = {name: x for name, x in field[key].items() if name in earlier}
    if "uptake_per_volume" in field:
        field.pop("uptake", None)
    if field.get("uptake_on") and not _takes_up(field):
        del field["uptake_on"]
    for name in list(field.get("secretion_from", {})):
        if not _takes_up(fields[name]):
            del field["secretion_from"][name]
    radius = base(scene.get("cells", {}).get("division_radius", 5.0))
    if "spacing" in field and base(field["spacing"]) > 4.0 * radius:
        field["spacing"] = radius
    if flat and field.get("geometry") == "radial":
        del field["geometry"]
    if "domain" in scene:
        field.pop("geometry", None)
        if "spacing" in field:
            field["spacing"] = radius
    if "layer" in field and not flat and "domain" not in scene:
        field["geometry"] = "radial"
    if field.get("geometry") != "radial":
        field.pop("layer", None)
    _fit_sides(field, flat)
    _fit_sources(scene, field, flat)
    _fit_regions(scene, field, flat)
    if "finite_medium" in field:
        _fit_medium(field)
    if "diffusion_medium" in field:
        inside = base(field.get("diffusion", 2000.0))
        field["diffusion_medium"] = min(
            max(base(field["diffusion_medium"]), inside / 50), 50 * inside
        )
    if "necrosis" in field and "quiescence" in field:
        low, high = sorted((base(field["necrosis"]), base(field["quiescence"])))
        field["necrosis"], field["quiescence"] = low, high if high > low else 2.0 * low + 1e-3


def _fit_energy(scene, fields):
    """Let ATP come from fields whose uptake is that of a volume, and have an effect."""
    energy = scene.get("energy")
    if energy is None:
        return
    made = {
        name: gain for name, gain in energy.get("yields", {}).items()
        if gain > 0.0 and "uptake_per_volume" in fields.get(name, {})
    }  # fmt: skip
    if not made:
        del scene["energy"]
        return
    energy["yields"] = made
    effects = {"growth_half_saturation", "quiescence", "necrosis"}
    if not effects & energy.keys():
        energy["necrosis"] = 1e-4
    if "necrosis" in energy and "quiescence" in energy:
        low, high = sorted((base(energy["necrosis"]), base(energy["quiescence"])))
        energy["necrosis"], energy["quiescence"] = low, high if high > low else 2.0 * low + 1e-6


BEHAVIOURS = {
    "growth rate": ("growth", 1.0), "rest": ("growth", 1.0), "apoptosis rate": ("", 1e-5),
    "necrosis rate": ("", 1e-5), "damage rate": ("", 1e-5), "division radius": ("growth", 1.1),
    "speed": ("motility", 2.0),
    "receptors": ("adhesion", 0.5), "Young's modulus": ("", 2.0),
}  # fmt: skip
"""Behaviours -> the table that they need, and a value that responses may lead to."""


def _fit_responses(scene, fields, types):
    """Let responses name behaviours and signals that there are, with the keys of their laws."""
    young = scene.get("cells", {})
    drift = {n: x for n, x in young.get("drift", {}).items() if n in young.get("heritable", ())}
    young.pop("drift", None)
    if drift:
        young["drift"] = drift
    for part in scene.get("signals", {}).values():
        part["of"] = {
            n: 0.1 + abs(base(x)) for n, x in part.get("of", {}).items()
            if n in (*fields, "pressure", "age", "neighbours")
        } or {"age": 3600.0}  # fmt: skip
    signals = [*fields, *scene.get("signals", {}), "pressure", "age", "volume", "time",
               "neighbours", *(f"contacts with {name}" for name in types)]  # fmt: skip
    phases = bool(scene.get("growth", {}).get("phases"))
    known = {n: x for n, (needs, x) in BEHAVIOURS.items() if not needs or needs in scene}
    if phases:
        known["entry into S"] = known.pop("division radius")
    known |= {f"change to {name}": 1e-5 for name in types}
    for place, (name, part) in enumerate(scene.get("responses", {}).items()):
        seed = sum(map(ord, name + str(part.get("behaviour", "")))) + 7 * place
        behaviour = list(known)[seed % len(known)]
        law = part.get("law", "hill")
        made = {"behaviour": behaviour, "law": law, "largest": known[behaviour]}
        if law != "constant":
            made["signal"] = signals[seed % len(signals)]
        if law in ("hill", "monod", "inhibition", "threshold"):
            made["half"] = 0.01 + abs(base(part.get("half", 1.0)))
        if law == "linear":
            made |= {"begin": 0.0, "end": 1.0}
        if law == "table":
            del made["largest"]
            made["points"] = [[0.0, 0.0], [1.0, known[behaviour]]]
        if law == "hill":
            made["power"] = 2.0
        if made.get("largest") == 1.0:
            made["base"] = 0.1
        if law in ("hill", "monod", "threshold", "linear") and seed % 2:
            made |= {"falls": True, "base": 0.1 * known[behaviour]}
        if behaviour in ("growth rate", "rest", "apoptosis rate"):
            made["combine"] = {"growth rate": "minimum", "rest": "maximum"}.get(behaviour, "sum")
        if types and part.get("cells"):
            made["cells"] = types[seed % len(types)]
        scene["responses"][name] = made


def _fit_sources(scene, field, flat):
    """Let sources be points at the origin, or where there is a domain a plane through it."""
    if field.get("geometry", "box") != "box":
        field.pop("sources", None)
    for source in field.get("sources", {}).values():
        strength, flux = source.get("strength", 1.0), source.get("flux")
        source.clear()
        if flux is not None and "x" in scene.get("domain", {}):
            source |= {"y": 0.0, "flux": flux}
        else:
            source |= {"strength": strength, **dict.fromkeys("xy" if flat else "xyz", 0.0)}


def _fit_regions(scene, field, flat):
    """Let regions lie in the middle, where any domain is, and differ as much as solvers follow."""
    if field.get("geometry", "box") != "box":
        field.pop("regions", None)
    tissue = base(field.get("diffusion", 2000.0))
    for region in field.get("regions", {}).values():
        ratio = min(max(base(region["diffusion"]) / tissue, 1e-3), 1e3)
        region["diffusion"] = ratio * tissue
        for axis in [axis for axis in "xyz" if axis in region]:
            region[axis] = [-2.0, 3.0]
        if flat:
            region.pop("z", None)


def _fit_medium(field):
    """Let a finite medium be all that a field exchanges with, and larger than any grid here."""
    volume = base(field["finite_medium"]["volume"])
    field["finite_medium"]["volume"] = max(volume, 1e12)
    field.pop("media_change", None)
    for side in field.get("sides", {}).values():
        side.pop("value", None)
        if side.get("type") == "derivative":
            side["derivative"] = 0.0


def _fit_sides(field, flat):
    geometry = field.get("geometry", "box")
    sides = field.get("sides", {})
    for face in list(sides):
        shell = face in ("*", "r+") if geometry != "box" else face != "r+"
        if not shell or (flat and (face.startswith("z") or face == "r+")):
            del sides[face]
    for side in sides.values():
        kind = side.get("type", "value")
        if kind != "derivative":
            side.pop("derivative", None)
        else:
            side.setdefault("derivative", 0.0)
            side.pop("value", None)
        if kind != "mixed":
            side.pop("rate", None)
        else:
            side.setdefault("rate", 0.02)
    closed = sides and all(side.get("type") == "derivative" for side in sides.values())
    if closed:
        next(iter(sides.values())).clear()
        if "*" in sides:
            sides["*"] = {}


@st.composite
def plausible(draw, extreme=0.004, small=True):
    """Draw the entries of a scene that fits together; ``small``: that runs in a moment."""
    drawer = Drawer(draw, extreme)
    scene = drawer.part(Scene, "")
    if drawer.chance(0.7):  # most starts are arranged
        scene.get("initial", {}).pop("cells", None)
    if small:
        step = scene["coupling_step"] = drawer.one_of([1.0, 10.0, 60.0, 600.0, 1800.0])
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
            field["margin"] = min(base(field.get("margin", 50.0)), 60.0)
            field["spacing"] = max(base(field.get("spacing", 8.0)), 4.0)
            field["time_tolerance"] = max(field.get("time_tolerance", 1e-2), 1e-3)
        if drawer.chance(0.97):
            _let_steps_be_few(scene, options)
        if "domain" in scene and drawer.chance(0.9):
            scene["initial"]["jitter"] = min(scene["initial"].get("jitter", 0.0), 0.3)
    if drawer.chance(0.95):
        _let_the_method_hold(scene)
    scene = fitted(scene)
    if small:
        _loosen(scene)
        for field in scene.get("nutrients", {}).values():
            radius = base(scene.get("cells", {}).get("division_radius", 5.0))
            across = base(field["spacing"]) if "spacing" in field else radius
            field["margin"] = min(base(field["margin"]), 12.0 * across)
        step = scene["coupling_step"]
        scene["duration"] = step * drawer.one_of([1.0, 2.0, 2.5, 3.0])
    return scene


def _let_the_method_hold(scene):
    """Take another method where the scene's own would refuse its cells or their friction."""
    options = scene.get("integrator", {})
    options = {"method": options} if isinstance(options, str) else options
    info = METHODS.get(options.get("method", "cvode"))
    count = scene.get("initial", {}).get("count", 1)
    if info is not None and info.refusal(count, friction="friction" in scene):
        scene["integrator"] = {**options, "method": "cvode"}


def _let_steps_be_few(scene, options):
    """Ask no more of a method than it does in a moment: order 1 takes 1 / tolerance steps."""
    radius = base(scene.get("cells", {}).get("division_radius", 5.0))
    first = options.get("method") in ("euler-adaptive", "multirate-euler")
    least = (2e-2 if first else 1e-5) * radius
    options["atol"] = min(max(base(options.get("atol", 0.01)), least), 0.1 * radius)
    options["rtol"] = max(options.get("rtol", 1e-6), 1e-4 if first else 1e-9)


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


def look_until(done, look, examples=100, most=60):
    """Call ``look`` with plausible scenes of any size, of other seeds each time, until ``done``."""
    for number in range(most):
        drawing = given(entries=plausible(small=False))(lambda entries: look(entries))
        limits = settings(max_examples=examples, deadline=None, phases=[hypothesis.Phase.generate],
                          suppress_health_check=list(HealthCheck))  # fmt: skip
        hypothesis.seed(number)(limits(drawing))()
        if done():
            return


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
