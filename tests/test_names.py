"""One name, one thing: what modules offer is called the same nowhere else in the package."""

import ast
from collections import defaultdict
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

import multicell

PACKAGE = Path(multicell.__file__).parent
TOP = Path(__file__).parent.parent


# each family of methods hands its own to the registry by this name
PROTOCOL = {"METHODS"}


def names_of(item):
    """Return the names of what a line of a module makes: functions, classes, constants."""
    if isinstance(item, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        return [item.name]
    targets = item.targets if isinstance(item, ast.Assign) else [getattr(item, "target", None)]
    flat = [each for target in targets for each in getattr(target, "elts", [target])]
    names = [target.id for target in flat if isinstance(target, ast.Name)]
    # two letters or more: not the variables of types
    return [name for name in names if name.isupper() and len(name) > 1]


def offered(text):
    """Return the public functions, classes and constants of a module."""
    names = [name for item in ast.parse(text).body for name in names_of(item)]
    return [name for name in dict.fromkeys(names) if not name.startswith("_")]


def shared(folder):
    """Return the names that several modules of a folder have, with their files."""
    where = defaultdict(list)
    for path in sorted(folder.rglob("*.py")):
        # its one function is the installed command's, which names it together with the module
        if path.name != "__main__.py":
            for name in {*offered(path.read_text(encoding="utf-8"))} - PROTOCOL:
                where[name].append(path.relative_to(folder).as_posix())
    return {name: files for name, files in where.items() if len(files) > 1}


def test_public_functions_classes_and_constants_have_names_of_their_own():
    assert shared(PACKAGE) == {}


def test_names_in_two_modules_are_seen(tmp_path):
    (tmp_path / "inner").mkdir()
    (tmp_path / "a.py").write_text("class State: ...\ndef _own(): ...\nA, BC = 1, 2\n")
    (tmp_path / "inner" / "b.py").write_text("def State(): ...\ndef _own(): ...\nBC: int = 3\n")
    assert shared(tmp_path) == {name: ["a.py", "inner/b.py"] for name in ("State", "BC")}


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


QUESTIONS = ("What", "How", "Where", "Whether", "Which", "Who", "Return what", "Yield what")


def titles_like_questions(folder):
    """Return the docstrings that begin with a question where a noun could be searched for.

    A function may begin with 'Whether': it says that a value is a bool.
    """
    found = []
    for path in sorted(folder.rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        kinds = ast.Module | ast.FunctionDef | ast.ClassDef
        for item in (item for item in ast.walk(tree) if isinstance(item, kinds)):
            title = (ast.get_docstring(item) or "").split("\n")[0]
            asked = QUESTIONS if isinstance(item, ast.Module) else ("What", *QUESTIONS[-2:])
            if title.startswith(tuple(f"{word} " for word in asked)):
                found.append(f"{path.relative_to(folder).as_posix()}: {title}")
    return found


@pytest.mark.parametrize(
    "folder", [PACKAGE, *(TOP / name for name in ("tests", "docs", "examples"))]
)
def test_titles_name_their_subject(folder):
    assert titles_like_questions(folder) == []


def test_titles_that_ask_are_seen(tmp_path):
    (tmp_path / "a.py").write_text('"""How it goes."""\ndef f():\n    """Return what is."""\n')
    assert titles_like_questions(tmp_path) == ["a.py: How it goes.", "a.py: Return what is."]


def numbers_without_reason(folder):
    """Return the numbers of modules that have neither a comment nor a text below them.

    Those that count something, up to two, explain themselves.
    """
    found = []
    for path in sorted(folder.rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        lines, body = text.splitlines(), ast.parse(text).body
        for item, after in zip(body, [*body[1:], None], strict=True):
            if not isinstance(item, ast.Assign | ast.AnnAssign) or not _is_number(item.value):
                continue
            above = lines[max(item.lineno - 2, 0)].lstrip()
            own = " ".join(lines[item.lineno - 1 : item.end_lineno])
            below = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
            if "#" not in own and not above.startswith("#") and not below:
                found.append(f"{path.relative_to(folder).as_posix()}: {ast.unparse(item)}")
    return found


def _is_number(value):
    """Return whether an expression consists of numbers alone, of which one is above two."""
    allowed = (ast.Constant, ast.UnaryOp, ast.BinOp, ast.Tuple, ast.operator, ast.unaryop, ast.Load)
    parts = list(ast.walk(value)) if value is not None else []
    known = [part.value for part in parts if isinstance(part, ast.Constant)]
    numbers = [x for x in known if isinstance(x, int | float) and not isinstance(x, bool)]
    plain = all(isinstance(part, allowed) for part in parts) and len(numbers) == len(known)
    return plain and any(x not in (0, 1, 2) for x in numbers)


def test_numbers_have_reasons():
    assert numbers_without_reason(PACKAGE) == []


def test_numbers_without_reasons_are_seen(tmp_path):
    (tmp_path / "a.py").write_text(
        "_ONE = 1\n_FAR = 8.0\n_NEAR: float = 3  # µm\n_BOTH = (0.5, 2)\n"
        "# of cells\n_MANY = 10**7\n_LAST = -1e-3\n"
    )
    assert numbers_without_reason(tmp_path) == [
        "a.py: _FAR = 8.0", "a.py: _BOTH = (0.5, 2)", "a.py: _LAST = -0.001",
    ]  # fmt: skip


def arrows(folder, top):
    """Return for each module of a folder which others of it are imported, in any way and place."""
    names = {
        ".".join([top, *path.relative_to(folder).with_suffix("").parts]): path
        for path in folder.rglob("*.py")
        if path.name != "__init__.py"
    }
    return {
        name: {
            node.module
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
            if isinstance(node, ast.ImportFrom) and node.module in names
        }
        for name, path in names.items()
    }


@pytest.mark.parametrize("room", ["calibration", "comparison"])
def test_results_and_their_pages_make_no_circle(room):
    """Imports in functions and those for annotations count, which the linter leaves out."""
    found = arrows(PACKAGE / room, f"multicell.{room}")
    assert set(TopologicalSorter(found).static_order()) == set(found)


def test_circles_are_seen(tmp_path):
    (tmp_path / "a.py").write_text("def f():\n    from room.b import B\n")
    (tmp_path / "b.py").write_text("if TYPE_CHECKING:\n    from room.a import f\n")
    with pytest.raises(CycleError):
        TopologicalSorter(arrows(tmp_path, "room")).prepare()
