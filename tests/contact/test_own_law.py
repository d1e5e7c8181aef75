"""Laws of the user's own: as good as ours, from any file, and never from a stale cache."""

import json
import math
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from click.testing import CliRunner
from running import copy_lists
from scipy.integrate import quad

import multicell as mc
from multicell.cli.main import main
from multicell.plugins.fingerprints import fingerprint
from multicell.plugins.user_laws import load_law
from multicell.schema import quantity
from multicell.testing import check_pair_law, pair_laws

LAW = """
import multicell as mc

FACTOR = {factor}

def helper(x):
    return FACTOR * x

@mc.pair_law(parameters={{"stiffness": "nN/um"}})
def Square(overlap, modulus, radius, p):
    return p.stiffness * helper(overlap) * overlap / radius
"""

RUN = """
import json, sys
import numpy as np
import multicell as mc
from multicell.mechanics import forces
from multicell.mechanics.motion import Motion
from multicell.mechanics.system import Mechanics
law = mc.load_law(sys.argv[1])(stiffness=2.0)
system, two = Mechanics(law, 5.0), np.ones(2)
system.begin(Motion(5.0 * two, 0.0 * two, two, 0.5 * two, 0.0, 1.0))
position = np.array([[0.0, 0, 0], [9.0, 0, 0]])
force = system.force(0.0, position)[1, 0]
stats = forces.forces.stats
print(json.dumps([force, sum(stats.cache_hits.values()), sum(stats.cache_misses.values())]))
"""


@mc.pair_law(parameters={"stiffness": "nN/um", "range": quantity("um", default=1.0, above=0.0)},
             reach=lambda modulus, radius, rest, p: p.range)  # fmt: skip
def Bond(overlap, modulus, radius, p, rest):  # noqa: N802
    """A smooth bump of attraction, and a repulsion, with tanh from outside the usual."""
    x = (overlap + p.range) / rest
    return p.stiffness * x * x * rest * math.tanh(4.0 * overlap / p.range)


@pytest.mark.slow
def test_a_law_without_stiffness_and_energy_has_them_derived():
    law = Bond(stiffness="2 nN/um", range=1.5)
    check_pair_law(law)
    force, slope, energy = law.evaluate(0.7, 1.0, 2.5, rest=10.0)
    x = 2.2 / 10.0
    assert force == pytest.approx(2.0 * x * x * 10.0 * math.tanh(2.8 / 1.5), rel=1e-14)
    exact = quad(lambda h: float(law.evaluate(h, 1.0, 2.5, rest=10.0)[0]), -1.5, 0.7, epsabs=1e-13)
    assert energy == pytest.approx(exact[0], rel=1e-10)
    inside = 2.0 * x / 10.0 * math.tanh(2.8 / 1.5) + x * x * 4.0 / 1.5 / math.cosh(2.8 / 1.5) ** 2
    assert slope == pytest.approx(2.0 * 10.0 * inside, rel=1e-8)
    assert law.equilibrium_overlap(1.0, 2.5) == pytest.approx(0.0, abs=1e-9)
    with pytest.raises(TypeError, match="needs rest"):
        law.evaluate(0.7, 1.0, 2.5)


def process(folder, *arguments, code=0, **environment):
    """Run Python in a process that has never seen the law; return how it ended."""
    package = str(Path(mc.__file__).parents[1])
    done = subprocess.run(
        [sys.executable, *arguments], capture_output=True, text=True, cwd=folder, check=False,
        env=os.environ | {"PYTHONPATH": package, **environment},
    )  # fmt: skip
    assert done.returncode == code, done.stderr[-3000:]
    return done


def forces(folder, *arguments, code=RUN):
    cache = str(folder / "cache")
    return json.loads(process(folder, "-c", code, *arguments, NUMBA_CACHE_DIR=cache).stdout)


@pytest.mark.slow
def test_a_law_from_a_file_is_compiled_once_and_anew_after_every_edit(tmp_path):
    copy_lists(tmp_path / "cache")
    file = tmp_path / "mine.py"
    file.write_text(LAW.format(factor=1.0))
    expected = 2.0 / 2.5
    first, *_ = forces(tmp_path, "mine.py:Square")
    assert first == pytest.approx(expected, rel=1e-12)
    # the second process compiles nothing
    assert forces(tmp_path, "mine.py:Square") == [first, 1, 0]
    stamp = file.stat()
    # neither the function nor the date of the file changes, only a number that a helper reads
    file.write_text(LAW.format(factor=3.0))
    os.utime(file, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))
    force, hits, misses = forces(tmp_path, "mine.py:Square")
    assert (force, hits, misses) == (pytest.approx(3.0 * expected, rel=1e-12), 0, 1)
    # a process that knows nothing of the file can read the same cache
    ours = RUN.replace("mc.load_law(sys.argv[1])(stiffness=2.0)", "mc.Hertz()")
    assert forces(tmp_path, code=ours)[0] > 0.0


def test_fingerprints_change_with_all_that_a_function_reads():
    def made(source, names):
        space = dict(names)
        exec(source, space)
        return fingerprint(space["f"])

    plain = "def g(x):\n    return {0}\ndef f(x):\n    return g(x) * A"
    base = made(plain.format("x"), {"A": 1.0})
    assert made("# a comment\n\n" + plain.format("x"), {"A": 1.0}) == base
    others = [
        made(plain.format("x + 1"), {"A": 1.0}),
        made(plain.format("x"), {"A": 2.0}),
        made(plain.format("x").replace("* A", "/ A"), {"A": 1.0}),
        made(plain.format("x").replace("return g(x)", "return x"), {"A": 1.0}),
    ]
    assert len({base, *others}) == 5


def test_fingerprints_change_with_what_a_function_reads_of_modules_and_within():
    def made(source, *, half=2.0, power="x * x"):
        inner, helpers = ModuleType("inner"), ModuleType("helpers")
        inner.HALF, helpers.inner = half, inner
        exec(f"def power(x):\n    return {power}", vars(helpers))
        space = {"helpers": helpers, "math": math}
        exec(source, space)
        return fingerprint(space["f"])

    reads = "def f(x):\n    return math.sqrt(helpers.power(x)) / helpers.inner.HALF"
    within = "def f(x):\n    g = lambda y: helpers.power(y)\n    return g(x)"
    assert made(reads) == made(reads)
    assert len({made(reads), made(reads, half=3.0), made(reads, power="x * 2")}) == 3
    assert made(within) == made(within, half=3.0) != made(within, power="x * 2")


def test_a_scene_names_its_law_and_runs_no_file(tmp_path):
    file = tmp_path / "mine.py"
    file.write_text(LAW.format(factor=1.0))
    law = load_law(f"{file}:Square")
    scene = mc.load_scene("doublet-settle").with_changes({"contact": law(stiffness="2 nN/um")})
    written = tmp_path / "scene.toml"
    written.write_text(scene.to_toml())
    assert f'law = "mine.py:Square@{law.fingerprint}"' in written.read_text()
    assert mc.load_scene(written) == scene
    assert scene.with_changes({"contact.stiffness": 3.0}).contact == law(stiffness=3.0)
    plain = scene.with_changes({"contact.law": "jkr"})
    named = plain.with_changes({"contact": {"law": "mine.py:Square", "stiffness": 2.0}})
    assert named == scene
    # the law is another one now: what was written keeps meaning the first
    file.write_text(LAW.format(factor=2.0))
    changed = load_law(f"{file}:Square")
    assert changed is not law
    assert mc.load_scene(written).contact == law(stiffness=2.0)
    written.write_text(scene.to_toml().replace(law.fingerprint, "0" * 12))
    with pytest.raises(mc.SceneError, match="has changed since"):
        mc.load_scene(written)
    written.write_text(scene.to_toml().replace("mine.py", "other.py"))
    with pytest.raises(
        mc.SceneError, match=r"No scene runs a file by itself.*--law other.py:Square"
    ):
        mc.load_scene(written)


def test_a_run_by_a_law_of_ones_own_goes_as_by_ours():
    @mc.pair_law(
        parameters={"surface_energy": "nN/um"},
        stiffness=lambda overlap, modulus, radius, p, adhesion: (
            1.5 * modulus * math.sqrt(radius * overlap)
            - 0.75 * adhesion * math.sqrt(modulus * radius * math.sqrt(radius / overlap))
        ),
        energy=lambda overlap, modulus, radius, p, adhesion: (
            0.4 * modulus * overlap**2 * math.sqrt(radius * overlap)
            - 4 / 7 * adhesion * math.sqrt(modulus * math.sqrt(radius) * radius) * overlap**1.75
        ),
    )
    def Again(overlap, modulus, radius, p, adhesion):  # noqa: N802
        q = math.sqrt(radius * overlap)
        return modulus * overlap * q - adhesion * q * math.sqrt(modulus * q)

    scene = mc.load_scene("settle").with_changes({"initial.count": 30, "duration": "10 min"})
    ours, mine = (
        mc.run(scene.with_changes({"contact": law})).frames[-1].cells.position
        for law in (mc.JKR(), Again(surface_energy=0.1))
    )
    assert np.abs(ours - ours.mean(axis=0)).max() > 5.0
    np.testing.assert_allclose(mine, ours, atol=1e-6)


def broken(**options):
    def Law(overlap, modulus, radius, p):  # noqa: N802
        return p.stiffness * overlap * overlap

    return mc.pair_law(parameters={"stiffness": "nN/um"}, **options)(Law)(stiffness=1.0)


SINGULAR = {
    "at the beginning": (
        lambda overlap, modulus, radius, p, rest: -p.stiffness * math.log(overlap / rest), None,
    ),
    "at contact": (
        lambda overlap, modulus, radius, p, rest: (
            p.stiffness * math.log(abs(overlap) / rest + 1e-300)
        ),
        lambda modulus, radius, rest, p: 0.1 * rest,
    ),
}  # fmt: skip
"""Forces with a logarithm that is not finite somewhere, though its integral is."""


def singular(name):
    force, reach = SINGULAR[name]
    force.__name__ = "Logarithmic"
    return mc.pair_law(parameters={"stiffness": "nN/um"}, reach=reach)(force)(stiffness=2.0)


@pytest.mark.parametrize("name", SINGULAR)
def test_the_energy_of_a_force_with_a_logarithmic_singularity_is_its_integral(name):
    law = singular(name)
    begin = -float(law.reach(1.0, 2.5, rest=10.0))
    for overlap in (1e-3, 0.7, 4.0):
        # ∫ ln|x| dx = x ln|x| - x, taken from the beginning
        x = np.array([begin, overlap]) / 10.0
        parts = np.where(x == 0.0, 0.0, x * np.log(np.abs(np.where(x == 0.0, 1.0, x))) - x)
        exact = 2.0 * 10.0 * float(parts[1] - parts[0]) * (-1.0 if begin == 0.0 else 1.0)
        assert law.energy(overlap, 1.0, 2.5, rest=10.0) == pytest.approx(exact, rel=1e-11)


@pytest.mark.slow
@pytest.mark.parametrize("name", SINGULAR)
def test_a_law_with_a_logarithmic_singularity_is_accepted(name, monkeypatch):
    # compiling a law shows nothing of this; each size and each modulus once
    for check in ("test_compiled_law_is_the_function", "test_no_pair_of_a_cluster_is_missed"):
        monkeypatch.setattr(pair_laws.PairLawTests, check, lambda *_: None)
    monkeypatch.setattr(pair_laws, "_PAIRS", pair_laws._PAIRS[::4])
    assert len({*pair_laws._PAIRS}) == 3
    check_pair_law(singular(name))


def test_a_force_of_noise_has_an_energy_in_finite_time():
    @mc.pair_law(parameters={"stiffness": "nN/um"})
    def Noise(overlap, modulus, radius, p):  # noqa: N802
        return p.stiffness * (1.0 + 1e-6 * math.sin(1e15 * overlap))

    energy = Noise(stiffness=1.0).energy(1.0, 1.0, 2.5)
    assert energy == pytest.approx(1.0, rel=1e-5)


@pytest.mark.parametrize(
    ("options", "fault"),
    [
        ({"stiffness": lambda overlap, modulus, radius, p: p.stiffness * overlap},
         "stiffness is not the slope"),
        ({"energy": lambda overlap, modulus, radius, p: p.stiffness * overlap**3},
         "force is not the slope"),
        ({"reach": lambda modulus, radius, rest, p: 1.0 + modulus}, "reach rises"),
        ({"reach": lambda modulus, radius, rest, p: 4.0 / radius}, "reach falls"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_law_is_found(options, fault, monkeypatch):
    # compiling a law shows nothing of these
    for check in ("test_compiled_law_is_the_function", "test_no_pair_of_a_cluster_is_missed"):
        monkeypatch.setattr(pair_laws.PairLawTests, check, lambda *_: None)
    with pytest.raises(AssertionError, match=fault):
        check_pair_law(broken(**options))


def test_laws_that_are_none_are_refused_with_words(tmp_path):
    with pytest.raises(TypeError, match="must have the arguments overlap, modulus, radius, p"):
        mc.pair_law(parameters={})(lambda h, e, r: h)
    for name in ("evaluate", "reach", "medium_drag", "a__b"):
        with pytest.raises(TypeError, match=f"'{name}' cannot be the name"):
            mc.pair_law(parameters={name: "um"})(lambda overlap, modulus, radius, p: 0.0)
    with pytest.raises(mc.SceneError, match="stiffness"):
        Bond(stiffness="2 um")
    with pytest.raises(mc.SceneError, match=r"range.*above 0"):
        Bond(stiffness=1.0, range=-1.0)
    (tmp_path / "mine.py").write_text("def Law(x): return x")
    with pytest.raises(mc.SceneError, match="is neither a pair law nor a growth law"):
        load_law(f"{tmp_path / 'mine.py'}:Law")


def command(folder, *arguments, code=0):
    """Run the command line in such a process; return what it prints."""
    done = process(folder, "-m", "multicell", *arguments, code=code)
    return done.stdout + done.stderr


def invoked(*arguments, code=0):
    """Run the command line in this process; return what it prints."""
    done = CliRunner().invoke(main, arguments)
    assert done.exit_code == code, done.output
    return done.output


@pytest.mark.slow
def test_a_law_goes_through_the_commands(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text(LAW.format(factor=1.0))
    own = ("--law", "mine.py:Square")
    scene = ("doublet-settle", "--set", "duration=10 min", "--set", "integrator=cvode")
    assert "contact.stiffness: is missing" in invoked("explain", *scene, *own, code=2)
    stiff = (*own, "--set", "contact.stiffness=2")
    told = invoked("explain", *scene, *stiff)
    assert "a law of your own: stiffness 2 nN/um" in " ".join(told.split())
    invoked("run", *scene, *stiff, "-o", "out", "--no-report")
    written = (tmp_path / "out" / "scene.toml").read_text()
    assert 'law = "mine.py:Square@' in written
    # a folder runs no file by itself: a process that has never seen the law says what it needs
    longer = ("resume", "out", "--set", "duration=20 min", "--no-report")
    assert "--law mine.py:Square" in command(tmp_path, *longer, code=2)
    command(tmp_path, *longer, *own)
    invoked("export", "out", "-o", "tables", *own)
    assert (tmp_path / "tables" / "cells.csv").stat().st_size > 0
    invoked("compare", *scene, *stiff, "--methods", "cvode", "--budget", "2", "-o", "chart")
    (tmp_path / "mine.py").write_text(LAW.format(factor=2.0))
    assert "has changed since" in command(tmp_path, *longer, *own, code=2)
