"""Rules for every test and every file, read from their source."""

import ast
import functools
import importlib
from pathlib import Path
from types import SimpleNamespace

import pytest

TESTS = Path(__file__).parent
FILES = sorted(TESTS.rglob("*.py"))
# functions of numpy.testing, pytest and multicell.testing that say what must hold
CHECKS = ("assert_", "check_", "raises", "warns")


@functools.cache
def tree(path):
    return ast.parse(path.read_text(encoding="utf-8"))


def functions(node):
    return [item for item in ast.walk(node) if isinstance(item, ast.FunctionDef)]


def called(node):
    """Return the last names of all that a function calls."""
    calls = [item.func for item in ast.walk(node) if isinstance(item, ast.Call)]
    return {call.attr if isinstance(call, ast.Attribute) else getattr(call, "id", "")
            for call in calls}  # fmt: skip


def checking(functions):
    """Return the names of the functions that check something, or call one that does."""
    said = {
        function.name
        for function in functions
        if any(isinstance(item, ast.Assert | ast.Raise) for item in ast.walk(function))
        or any(name.startswith(CHECKS) for name in called(function))
    }
    while more := {f.name for f in functions if f.name not in said and called(f) & said}:
        said |= more
    return said


def unchecked(path, shared=frozenset()):
    """Return the tests of a file that assert nothing, by themselves or by a helper."""
    found = functions(tree(path))
    known = checking(found) | shared
    tests = [item for item in found if item.name.startswith("test_")]
    return [test.name for test in tests if test.name not in known and not called(test) & known]


def alternatives(path):
    """Return the lines of assertions that hold if either of two things does."""
    return [
        item.lineno
        for item in ast.walk(tree(path))
        if isinstance(item, ast.Assert)
        and isinstance(item.test, ast.BoolOp)
        and isinstance(item.test.op, ast.Or)
    ]


def broken(rule):
    """Return offences against a rule, by file."""
    return {str(path.relative_to(TESTS)): found for path in FILES if (found := rule(path))}


def test_every_test_asserts():
    helpers = (TESTS / "helpers").glob("*.py")
    shared = {name for path in helpers for name in checking(functions(tree(path)))}
    assert broken(lambda path: unchecked(path, shared)) == {}


def test_no_assertion_is_joined_by_or():
    assert broken(alternatives) == {}


def test_names_of_test_files_are_given_once():
    """Files without packages are modules by their names alone."""
    names = [path.name for path in FILES if path.name != "conftest.py"]
    assert len(names) == len(set(names))


def modules(path):
    """Return the modules that a file imports, at its head or within functions."""
    names = []
    for item in ast.walk(tree(path)):
        if isinstance(item, ast.ImportFrom):
            names.append(item.module or "")
        elif isinstance(item, ast.Import):
            names += [alias.name for alias in item.names]
    return names


def imported(path):
    """Return forbidden imports of a file: other files of tests, whose shared parts belong into
    helpers, and ``tests`` as a package, which it is only for a Python that starts in its folder."""
    tests = {path.stem for path in FILES if path.name.startswith("test_")}
    return [
        name
        for name in modules(path)
        if name.rpartition(".")[2] in tests or name.partition(".")[0] == "tests"
    ]


def beyond(path, missing):
    """Return imports of a file that fail where modules are missing; ``importorskip`` may ask."""
    return [name for name in modules(path) if name.partition(".")[0] in missing]


def test_no_test_file_imports_another():
    assert broken(imported) == {}


def test_imports_of_test_files_are_seen(tmp_path):
    path = tmp_path / "test_more.py"
    path.write_text(
        "import os\nfrom test_rules import tree\nimport test_names as names\n"
        "from tests.helpers.a import b\n"
    )
    assert imported(path) == ["test_rules", "test_names", "tests.helpers.a"]


def test_tests_run_with_what_the_readme_installs_for_them(tmp_path, monkeypatch):
    """An environment of developers has more: Sphinx, notebooks, linters."""
    monkeypatch.syspath_prepend(str(TESTS.parent / "docs" / "extensions"))
    missing = importlib.import_module("requirements").refused([".[test]"])
    assert "pytest" not in missing
    assert broken(lambda path: beyond(path, missing)) == {}
    path = tmp_path / "test_more.py"
    path.write_text("import os\ndef test():\n    from IPython.core import release\n")
    assert beyond(path, {"IPython", "nbformat"}) == ["IPython.core"]


def test_the_rules_see_what_breaks_them(tmp_path):
    file = tmp_path / "test_bad.py"
    bad = ["def help(x): assert x", "def test_a(): help(1)", "def test_b(): print(1)"]
    file.write_text("\n".join([*bad, "def test_c(): assert 1 or 2"]))
    assert unchecked(file) == ["test_b"]
    assert alternatives(file) == [4]


@pytest.mark.parametrize(("asked", "left"), [("", 1), ("not slow", 1), ("benchmark", 2)])
def test_benchmarks_run_where_they_are_asked_for(asked, left, request):
    """Also with other marks on the command line, which replace those of the settings."""
    (own,) = (p for p in request.config.pluginmanager.get_plugins() if hasattr(p, "ROOMS"))
    gone = []
    config = SimpleNamespace(
        args=[],
        option=SimpleNamespace(markexpr=asked),
        hook=SimpleNamespace(pytest_deselected=lambda items: gone.extend(items)),
    )
    items = [
        SimpleNamespace(path=Path("tests/cli/test_a.py"), get_closest_marker={}.get),
        SimpleNamespace(path=Path("tests/b.py"), get_closest_marker={"benchmark": True}.get),
    ]
    for item in items:
        item.nodeid = f"{item.path}::test_a"
    own.pytest_collection_modifyitems(config, items)
    assert (len(items), len(gone)) == (left, 2 - left)
    items[0].nodeid += "[<function f at 0x7f0d7967f4c0>]"
    with pytest.raises(pytest.UsageError, match="an address in its name"):
        own.pytest_collection_modifyitems(config, items)


def test_all_but_a_sample_is_slow(request):
    """Misspelt parameters would make all of a test slow."""
    (own,) = (p for p in request.config.pluginmanager.get_plugins() if hasattr(p, "ROOMS"))

    def collected(*asked, node="tests"):
        slow, items = [], []
        for name in ("a", "b", "c"):
            markers = {"sample": SimpleNamespace(args=asked)}
            items.append(SimpleNamespace(
                path=Path("tests/a.py"), nodeid=f"tests/a.py::test[{name}]",
                get_closest_marker=markers.get, callspec=SimpleNamespace(id=name),
                add_marker=lambda _, name=name: slow.append(name),
            ))  # fmt: skip
        option = SimpleNamespace(markexpr="benchmark")
        own.pytest_collection_modifyitems(SimpleNamespace(args=[node], option=option), items)
        return "".join(slow)

    assert collected("a", "c") == "b"
    with pytest.raises(pytest.UsageError, match=r"tests/a.py::test.*'d'"):
        collected("a", "d")
    assert collected("a", "d", node="tests/a.py::test[a]") == "bc"
