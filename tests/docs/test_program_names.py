"""Programs use names that the package has: most are run by hand, long after a name has changed."""

import ast
import importlib
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]
FOLDERS = ("docs/programs", "tests/benchmarks", "examples")
PROGRAMS = [path for folder in FOLDERS for path in sorted((ROOT / folder).rglob("*.py"))]


def missing_names(text):
    """Return names of the package in a program that its modules lack."""
    modules, missing = {}, []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name.partition(".")[0] == "multicell":
                    found = importlib.import_module(alias.name)
                    name = alias.asname or "multicell"
                    modules[name] = found if alias.asname else importlib.import_module("multicell")
        elif isinstance(node, ast.ImportFrom) and (node.module or "").startswith("multicell"):
            found = importlib.import_module(node.module)
            for alias in node.names:
                value = attribute(found, alias.name)
                if value is None:
                    missing.append(f"{node.module}.{alias.name}")
                elif isinstance(value[0], ModuleType):
                    modules[alias.asname or alias.name] = value[0]
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            module = modules.get(node.value.id)
            if module is not None and attribute(module, node.attr) is None:
                missing.append(f"{module.__name__}.{node.attr}")
    return missing


def attribute(module, name):
    """Return the value of a name of a module in a tuple, or None; a submodule is one, too."""
    if hasattr(module, name):
        return (getattr(module, name),)
    try:
        return (importlib.import_module(f"{module.__name__}.{name}"),)
    except ModuleNotFoundError:
        return None


@pytest.mark.parametrize("path", PROGRAMS, ids=[path.stem for path in PROGRAMS])
def test_programs_take_what_the_package_has(path):
    assert missing_names(path.read_text("utf-8")) == []


def test_a_name_that_is_gone_is_noticed():
    text = (
        "import multicell as mc\nfrom multicell.integrators import nowhere, stepping\n"
        "walk[stepping.STEP], stepping.DONE, mc.Simulation, mc.nothing"
    )
    assert sorted(missing_names(text)) == [
        "multicell.integrators.nowhere",
        "multicell.integrators.stepping.STEP",
        "multicell.nothing",
    ]
