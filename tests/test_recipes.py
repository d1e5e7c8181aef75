"""The recipes of CONTRIBUTING.md, followed in a copy of the package."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import multicell

PACKAGE = Path(multicell.__file__).parent

LAW = '''
from typing import Any, final

import numpy as np

from multicell.contact.constants import constants_of
from multicell.contact.law import PairLaw
from multicell.schema import parameters, quantity


def harmonic(overlap, modulus, radius, p):
    h = max(overlap, 0.0)
    return p.stiffness * h, p.stiffness if overlap > 0.0 else 0.0, 0.5 * p.stiffness * h * h


_Constants = constants_of(harmonic, "stiffness")


@final
@parameters
class Harmonic(PairLaw):
    """A linear repulsion."""

    spring: float = quantity("nN/um", default=2.0, above=0.0, doc="dF/dh")

    def constants(self) -> Any:
        return _Constants(self.spring)

    def describe(self, energy: str) -> str:
        return f"a linear repulsion of {self.spring:g} nN/um"

    def equilibrium_overlap(self, modulus, radius):
        return np.zeros(np.broadcast_shapes(np.shape(modulus), np.shape(radius)))
'''
METHOD = '''
@final
@dataclass(frozen=True)
class Kutta3(_Fixed):
    """Kutta's method of order 3."""

    info: ClassVar[MethodInfo] = MethodInfo(
        "kutta3", "explicit Runge-Kutta of order 3 with a fixed step", "step", order=3,
        stable=2.51, colour="#123456", marker="x",
    )
    tableau: ClassVar[Tableau] = _tableau([[0.5], [-1.0, 2.0]], [1 / 6, 2 / 3, 1 / 6])


METHODS = (Kutta3, Euler'''
SOLVER = '''
@final
class LazyFieldSolver(SolverBase):
    """Leave a field as it is."""

    name = "multicell-lazy"

    def make_stepper(self, state, dt=None):
        return lambda state, t_start, t_end: t_end


@final
class SteadyFieldSolver'''
RESPONSE = '''
@final
@dataclass(frozen=True)
class Exponential(HalfLaw):
    """1 - 2^(-s / half)."""

    def share(self, signal, *, falls):
        rest = 2.0 ** (-np.maximum(signal, 0.0) / self.half)
        return rest if falls else 1.0 - rest


RESPONSE_LAWS'''
GROWTH = '''
@final
@parameters
class QuadraticGrowth(GrowthLaw):
    """A rate that is proportional to the square of the volume."""

    def rate(self, volume, birth=1.0):
        return 0.5 * np.asarray(volume) ** 2 / birth

    def volume_after(self, volume, share, birth=1.0):
        return 1.0 / (1.0 / np.asarray(volume) - 0.5 * share / birth)

    def share_at(self, ratio):
        return 2.0 - 2.0 / np.asarray(ratio)


GROWTH_LAWS'''
LINEAR = '"linear": LinearGrowth, '
RADIUS = '    "radius": "um",\n'
OBSERVABLE = """OBSERVABLES: Final = (
    Observable("largest_cell", lambda s: s.cells.radius.max(initial=0.0), unit="um", doc="its r"),
"""
PAIR = """    for method in (
        NetworkMethod(
            "bogacki-shampine",
            EXPLICIT,
            RODAS3,
            _explicit(
                [[1 / 2], [0.0, 3 / 4], [2 / 9, 1 / 3, 4 / 9]],
                [2 / 9, 1 / 3, 4 / 9, 0.0],
                [-5 / 72, 1 / 12, 1 / 9, -1 / 8],
                3.0,
            ),
            "explicit pair of orders 3 and 2",
        ),
"""
DRAG = '"""Stokes drag 6πηr of the medium on every cell."""\n'
KEY = '\n    crowding: float = number(default=1.0, at_least=1.0, doc="more viscous by it")\n'
VISCOSITY = "        scene.drag.viscosity"
HARMONIC = "from multicell.contact.harmonic import Harmonic\n"
ENTRY = '        "hertz": Hertz,\n'
HILL = '    "hill": Hill,\n'

# recipe -> file -> pairs of what stands there and what takes its place; a new file has none
RECIPES = {
    "law": {
        "contact/harmonic.py": [("", LAW)],
        "contact/registry.py": [
            ("from multicell.contact.hertz", HARMONIC + "from multicell.contact.hertz"),
            (ENTRY, ENTRY + ENTRY.replace("hertz", "harmonic").replace("Hertz", "Harmonic")),
        ],
    },
    "method": {"integrators/runge_kutta.py": [("METHODS = (Euler", METHOD)]},
    "field solver": {
        "nutrient/equations/solvers.py": [("@final\nclass SteadyFieldSolver", SOLVER)]
    },
    "response": {"behaviours/laws.py": [
        ("RESPONSE_LAWS", RESPONSE), (HILL, HILL + '    "exponential": Exponential,\n')]},
    "growth law": {"behaviours/growth_laws/laws.py": [
        ("GROWTH_LAWS", GROWTH), (LINEAR, LINEAR + '"quadratic": QuadraticGrowth, ')]},
    "signal": {
        "behaviours/catalogue.py": [(RADIUS, RADIUS + '    "young": "kPa",\n')],
        "biology/responding.py": [('"volume", "radius")', '"volume", "radius", "young")')],
    },
    "observable": {"results/measures.py": [("OBSERVABLES: Final = (\n", OBSERVABLE)]},
    "key": {
        "scene/parts.py": [(DRAG, DRAG + KEY)],
        "simulation/assembly.py": [(VISCOSITY + ",", VISCOSITY + " * scene.drag.crowding,")],
    },
    "network method": {
        "networks/methods.py": [("    for method in (\n", PAIR)],
        "scene/networks.py": [('("auto", ', '("auto", "bogacki-shampine", ')],
    },
}  # fmt: skip

RUN = """
import json
import math
import multicell as mc
from multicell.report.explain.scene import explain
from multicell.nutrient.equations.solvers import SolverBase
from multicell.scene.json_schema import json_schema

@mc.network(states={"A": 1.0}, inputs={"oxygen": 0.0}, parameters={"k": 1e-3})
def decay(t, y, u, p, out):
    out[0] = -p[0] * y[0]

mc.testing.check_network(decay)

def end(**changes):
    scene = mc.load_scene("spheroid").with_changes({
        "initial.count": 8, "duration": "20 min", "contact": {"law": "harmonic", "spring": 3.0},
        "integrator": "kutta3", "growth.law": "quadratic",
        "responses.r": {"behaviour": "growth rate", "signal": "oxygen",
            "law": "exponential", "half": "0.05 mM"},
        "networks.own": {"network": decay, "inputs": {"oxygen": "oxygen"}, "dilution": False,
            "method": "bogacki-shampine", "tolerance": 1e-7},
        **{key.replace("__", "."): value for key, value in changes.items()}})
    return scene, mc.run(scene, threads=1, report=False)

(scene, result), (_, thick) = end(), end(drag__crowding=40.0)
_, fed = end(responses__r__half=1e-4)
_, stiff = end(responses__s={"behaviour": "growth rate", "signal": "young", "half": "1 kPa",
    "falls": True})
words, schema = str(explain(scene)), json.dumps(json_schema())
last, slow, grown, held = (run.frames[-1].cells for run in (result, thick, fed, stiff))
print(json.dumps({
    "law": ["a linear repulsion of 3 nN/um" in words, '"harmonic"' in schema],
    "method": ["kutta3" in words, '"kutta3"' in schema],
    "field solver": ["multicell-lazy" in SolverBase._subclasses],
    "response": ["half way at 0.05 mM" in words, '"exponential"' in schema,
                 bool(grown.volume.sum() > last.volume.sum())],
    "growth law": ["growth is quadratic" in words, '"quadratic"' in schema,
                   float(scene.growth.growth_law.share_at(2.0)) == 1.0],
    "signal": [bool(held.volume.sum() < last.volume.sum())],
    "observable": [float(result.history["largest_cell"][-1]) == float(last.radius.max())],
    "network method": ['"bogacki-shampine"' in schema, "by bogacki-shampine" in words,
                       bool(abs(last.inside[:, 0] - math.exp(-1.2)).max() < 1e-6)],
    "key": ['"crowding"' in schema, bool((slow.position != last.position).any())],
}))
"""


@pytest.fixture(scope="module")
def followed(tmp_path_factory):
    """Return the result of each recipe in a copy of the package in which all are followed."""
    folder = tmp_path_factory.mktemp("recipes")
    package = folder / "multicell"
    shutil.copytree(PACKAGE, package, ignore=shutil.ignore_patterns("__pycache__"))
    for files in RECIPES.values():
        for file, changes in files.items():
            path = package / file
            for old, new in changes:
                if old:
                    assert old in path.read_text()
                    path.write_text(path.read_text().replace(old, new, 1))
                else:
                    assert not path.exists()
                    path.write_text(new)
    done = subprocess.run(
        [sys.executable, "-P", "-c", RUN],
        env={**os.environ, "PYTHONPATH": str(folder), "NUMBA_CACHE_DIR": str(folder / "cache")},
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return json.loads(done.stdout)


@pytest.mark.slow
@pytest.mark.parametrize("name", RECIPES)
def test_a_new_part_takes_its_file_and_a_registry(name, followed):
    assert followed[name]
    assert all(followed[name])
    assert len(RECIPES[name]) <= 2
