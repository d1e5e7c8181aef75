"""Objects named as file.py:Name: what is loaded, and what is said of those that cannot be."""

import sys
from pathlib import Path

import pytest
from running import refused

from multicell.errors import SceneError
from multicell.plugins.fingerprints import fingerprint
from multicell.plugins.named import is_recorded_object, load_object, origin


def written(folder, text, name="mine.py"):
    (folder / name).write_text(text)
    return str(folder / name)


def test_an_object_is_loaded_once_and_again_when_its_file_has_changed(tmp_path):
    file = written(tmp_path, "class Own:\n    value = 1\n")
    first = load_object(f"{file}:Own", "integrator")
    assert first.value == 1
    assert load_object(f"{file}:Own", "integrator") is first
    assert sys.modules[first.__module__].Own is first
    assert origin(first) == f"{Path(file).resolve()}:Own"
    written(tmp_path, "class Own:\n    value = 2\n")
    assert load_object(f"{file}:Own", "integrator").value == 2


def test_a_file_may_import_its_neighbours_and_paths_may_be_relative(tmp_path, monkeypatch):
    written(tmp_path, "VALUE = 7\n", "neighbour_of_mine.py")
    written(tmp_path, "from neighbour_of_mine import VALUE\nclass A:\n    class B: value = VALUE\n")
    monkeypatch.chdir(tmp_path)
    before = list(sys.path)
    assert load_object("mine.py:A.B", "law").value == 7
    assert sys.path == before


@pytest.mark.parametrize(
    ("text", "spec", "problem"),
    [
        ("", "mine.py", "must have the form 'file.py:Name'"),
        ("", "mine.py:", "must have the form 'file.py:Name'"),
        ("", "mine.py:1a", "must have the form 'file.py:Name'"),
        ("", "other.py:A", "there is no file 'other.py'. It is looked for in"),
        ("", "mine.txt:A", "must end in .py"),
        ("class Own: pass", "mine.py:own", "has nothing called 'own'. Did you mean 'Own'"),
        ("class Own: pass", "mine.py:Own.x", "has nothing called 'Own.x'"),
        ("x = 1\n1 / 0\n", "mine.py:x", "line 2, raises ZeroDivisionError: division by zero"),
        ("x = (\n", "mine.py:x", "raises SyntaxError: '(' was never closed (mine.py, line 1)"),
        ("import nothing_of_this_name\n", "mine.py:x", "line 1, raises ModuleNotFoundError"),
        ("import sys\nsys.exit(3)\n", "mine.py:x", "line 2, raises SystemExit: 3"),
    ],
)
def test_what_cannot_be_loaded_is_said(text, spec, problem, tmp_path, monkeypatch):
    written(tmp_path, text)
    monkeypatch.chdir(tmp_path)
    known = set(sys.modules)
    with refused("integrator", problem):
        load_object(spec, "integrator")
    left = [name for name in set(sys.modules) - known if name.startswith("mine_")]
    # a file that runs stays loaded, for the next name that is asked of it
    assert len(left) == ("Own" in text)


def test_a_folder_and_an_unreadable_file(tmp_path):
    (tmp_path / "folder.py").mkdir()
    with pytest.raises(SceneError, match="cannot be read"):
        load_object(f"{tmp_path / 'folder.py'}:A", "law")


def test_the_form_of_a_name():
    assert is_recorded_object("mine.py:Own")
    assert is_recorded_object("__main__:Own(alpha=0.3, name='x:y')")
    assert not is_recorded_object("cvode")
    assert not is_recorded_object("mine.py:")
    assert not is_recorded_object("a\n.py:Own")


def test_a_fingerprint_changes_with_the_number_of_arguments():
    def one(x):
        return x

    def two(x, y):
        return x

    def keyword(x, *, y):
        return x

    def many(x, *y):
        return x

    marks = [fingerprint(function) for function in (one, two, keyword, many)]
    assert len(set(marks)) == 4
    assert fingerprint(one) == marks[0]
