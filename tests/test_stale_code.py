"""Compiled code on disk is that of today's files, wherever a helper or constant stands."""

import ast
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import multicell
from multicell.compiling import cache

PACKAGE = Path(multicell.__file__).parent
MODULES = {
    ".".join(file.relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(".__init__"): file
    for file in PACKAGE.rglob("*.py")
}

TAKEN = """
import sys
sys.path.insert(0, sys.argv[1])
import numpy as np
from multicell.nutrient import stencil
node = np.ones((1, 1, 1))
print(stencil.account(node, node, 1.0, node)[1], sum(stencil.account.stats.cache_hits.values()))
"""


@pytest.fixture
def copied(tmp_path):
    """Return a copy of the package, and what its compiled account says in a new process."""
    shutil.copytree(PACKAGE, tmp_path / "multicell", ignore=shutil.ignore_patterns("__pycache__"))

    def taken():
        done = subprocess.run(
            [sys.executable, "-P", "-c", TAKEN, str(tmp_path)],
            env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")},
            capture_output=True,
            text=True,
            check=True,
        )
        value, hits = done.stdout.split()
        return float(value), int(hits)

    return tmp_path / "multicell", taken


@pytest.mark.slow
def test_an_edited_helper_of_another_file_is_compiled_anew_and_a_page_is_not(copied):
    package, taken = copied
    assert taken() == (0.5, 0)
    page = package / "cli" / "main.py"
    page.write_text(page.read_text() + "\n# another line\n")
    assert taken() == (0.5, 1)
    helper = package / "nutrient" / "uptake.py"
    edited = helper.read_text().replace("most * c / (half", "most * c / 2 / (half")
    helper.write_text(edited)
    assert taken() == (0.25, 0)
    assert taken() == (0.25, 1)


@pytest.mark.slow
def test_a_stamp_changes_with_each_file_that_kernels_are_made_of(copied):
    package, _ = copied
    code = "import sys; sys.path.insert(0, sys.argv[1])\nfrom multicell.compiling import cache\n"
    code += "print(len(list(cache.sources())))\nfor file in cache.sources():\n"
    code += "    before = cache.stamp(); text = open(file).read()\n"
    code += "    open(file, 'w').write(text + '#'); cache.stamp.cache_clear()\n"
    code += "    assert cache.stamp() != before, file\n"
    code += "    open(file, 'w').write(text); cache.stamp.cache_clear()\n"
    code += "    assert cache.stamp() == before, file\n"
    command = [sys.executable, "-P", "-c", code, str(package.parent)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert int(done.stdout) == len(list(cache.sources())) > 80


def test_files_of_others_keep_the_stamp_of_numba(tmp_path):
    assert cache.stamp_of(str(tmp_path / "own.py")) is None
    assert cache.stamp_of(str(PACKAGE.parent / "multicell_extra" / "own.py")) is None
    drawn = cache.stamp_of(str(PACKAGE / "report" / "plots" / "space.py"))
    assert drawn not in (None, cache.stamp())


COMPILERS = ("jit", "inner", "inline", "arithmetic", "two_drivers", "compiled", "overload", "typed")
"""Parts of the names of what compiles a function, as a decorator or by a call."""


def _name(node):
    while isinstance(node, ast.Call):
        node = node.func
    return node.attr if isinstance(node, ast.Attribute) else getattr(node, "id", "")


def _compiled(tree):
    """Yield the functions of a module that numba compiles, without their annotations."""
    functions = {x.name: x for x in ast.walk(tree) if isinstance(x, ast.FunctionDef)}
    handed = {
        given.id
        for call in ast.walk(tree)
        if isinstance(call, ast.Call) and any(word in _name(call) for word in COMPILERS)
        for given in call.args
        if isinstance(given, ast.Name)
    }
    for name, function in functions.items():
        wrappers = [_name(x) for x in function.decorator_list]
        if name in handed or any(word in x for x in wrappers for word in COMPILERS):
            function.returns, function.decorator_list = None, []
            for part in ast.walk(function):
                if isinstance(part, ast.arg):
                    part.annotation = None
            yield function


@pytest.mark.slow
def test_what_kernels_read_of_other_files_is_in_their_stamp():
    known = {Path(file).resolve() for file in cache.sources()}
    read = set()
    for module, file in MODULES.items():
        tree = ast.parse(file.read_text())
        used = {
            part.id
            for function in _compiled(tree)
            for part in ast.walk(function)
            if isinstance(part, ast.Name)
        }
        for line in ast.walk(tree):
            if isinstance(line, ast.ImportFrom) and (line.module or "").startswith("multicell"):
                for name in line.names:
                    if (name.asname or name.name) in used:
                        whole = f"{line.module}.{name.name}"
                        read.add((module, whole if whole in MODULES else line.module))
    assert ("multicell.nutrient.stencil", "multicell.nutrient.uptake") in read
    assert ("multicell.integrators.loops.runge_kutta", "multicell.integrators.stepping") in read
    assert len(read) > 10
    assert {pair for pair in read if MODULES[pair[1]].resolve() not in known} == set()


def test_one_file_touches_the_insides_of_numba():
    allowed = "multicell.compiling.numba_068"
    inside = [
        module
        for module, file in MODULES.items()
        if any(word in file.read_text() for word in ("numba.core", "numba import core"))
    ]
    assert sorted(inside) == [allowed, "multicell.host.surroundings"]
    tree = ast.parse(MODULES["multicell.host.surroundings"].read_text())
    imports = [x for x in ast.walk(tree) if isinstance(x, ast.ImportFrom | ast.Import)]
    assert "numba" not in " ".join(ast.dump(x) for x in imports)
