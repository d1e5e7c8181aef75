"""One name, one thing: what modules offer is called the same nowhere else in the package."""

import ast
from collections import defaultdict
from pathlib import Path

import multicell

PACKAGE = Path(multicell.__file__).parent


def offered(text):
    """Return the public functions and classes of a module."""
    kinds = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef
    names = [item.name for item in ast.parse(text).body if isinstance(item, kinds)]
    return [name for name in names if not name.startswith("_")]


def shared(folder):
    """Return the names that several modules of a folder have, with their files."""
    where = defaultdict(list)
    for path in sorted(folder.rglob("*.py")):
        # its one function is the installed command's, which names it together with the module
        if path.name != "__main__.py":
            for name in offered(path.read_text(encoding="utf-8")):
                where[name].append(path.relative_to(folder).as_posix())
    return {name: files for name, files in where.items() if len(files) > 1}


def test_public_functions_and_classes_have_names_of_their_own():
    assert shared(PACKAGE) == {}


def test_names_in_two_modules_are_seen(tmp_path):
    (tmp_path / "inner").mkdir()
    (tmp_path / "a.py").write_text("class State: ...\ndef _own(): ...\ndef one(): ...\n")
    (tmp_path / "inner" / "b.py").write_text("def State(): ...\ndef _own(): ...\n")
    assert shared(tmp_path) == {"State": ["a.py", "inner/b.py"]}


def test_what_the_package_offers_comes_from_one_module_each():
    stub = (PACKAGE / "__init__.pyi").read_text(encoding="utf-8")
    lines = [item for item in ast.parse(stub).body if isinstance(item, ast.ImportFrom)]
    names = [alias.name for line in lines for alias in line.names]
    assert len(names) == len(set(names))
    missing = [
        f"{line.module}.{alias.name}"
        for line in lines
        for alias in line.names
        if line.module != "multicell"
        and alias.name not in offered(_source(line.module).read_text(encoding="utf-8"))
    ]
    assert missing == []


def _source(module):
    return PACKAGE.joinpath(*module.split(".")[1:]).with_suffix(".py")
