"""Measurements of a comparison outlive a full disk, a kill and a page that cannot be made."""

import errno
import os

import pytest
from two_cells import BOTH_EXACT, PAIR

import multicell.report.html as html
from multicell import OutputError
from multicell.comparison.measured import LOG_FILE
from multicell.comparison.result import WorkPrecision
from multicell.comparison.stability_limits import search
from multicell.comparison.stability_limits.search import stability
from multicell.comparison.work_precision import compare
from multicell.results.documents import Lines

SCENE = PAIR.with_changes({"duration": "120 s"})
METHODS = ["euler", "heun"]
COMPARED = {"ladder": {"step": [30.0, 15.0]}, "methods": METHODS, "repeats": 2}


def full(*_, **__):
    raise OutputError("cannot write") from OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def compared(folder, **more):
    words = []
    found = compare(SCENE, output=folder, progress=words.append, **{**COMPARED, **more})
    return found, [name for name in METHODS if any(w.startswith(f"{name} at") for w in words)]


def test_what_was_compared_is_there_before_its_page_is(tmp_path, monkeypatch):
    monkeypatch.setattr(html, "write_page", full)
    with pytest.raises(OutputError, match="cannot write"):
        compared(tmp_path)
    before = WorkPrecision.read(tmp_path / "workprecision.json")
    assert before.methods == METHODS
    monkeypatch.undo()
    again, measured = compared(tmp_path)
    assert measured == []
    assert again.table == before.table
    assert (tmp_path / "report.html").is_file()
    assert not (tmp_path / LOG_FILE).exists()
    with pytest.raises(OutputError, match="not empty"):
        compared(tmp_path)


def test_a_comparison_continues_with_the_methods_that_are_left(tmp_path):
    def ends(words):
        if words.startswith("heun"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        compare(SCENE, output=tmp_path, progress=ends, **COMPARED)
    assert not (tmp_path / "workprecision.json").exists()
    (known,) = Lines(tmp_path / LOG_FILE).entries[1:]
    again, measured = compared(tmp_path)
    assert (known["method"], measured) == ("euler", ["heun"])
    rows = again.rows("euler")
    errors = [name for name in rows[0] if name.startswith(("error", "worst"))]
    assert [[r[e] for e in errors] for r in rows] == [[r[e] for e in errors] for r in known["rows"]]
    assert all(r["cpu"] <= k["cpu"] for r, k in zip(rows, known["rows"], strict=True))


@pytest.mark.parametrize("more", [{"repeats": 3}, {"methods": ["euler"]}, {"shift": "1 um"}])
def test_another_comparison_does_not_continue_it(more, tmp_path, monkeypatch):
    monkeypatch.setattr(html, "write_page", full)
    with pytest.raises(OutputError, match="cannot write"):
        compared(tmp_path)
    monkeypatch.undo()
    with pytest.raises(OutputError, match="holds another comparison"):
        compared(tmp_path, **more)
    _, measured = compared(tmp_path, overwrite=True, **more)
    assert measured == list(more.get("methods", METHODS))


def test_what_may_have_changed_since_is_measured_again(tmp_path, monkeypatch):
    more = {"references": BOTH_EXACT}
    monkeypatch.setattr(html, "write_page", full)
    with pytest.raises(OutputError, match="cannot write"):
        compared(tmp_path, **more)
    monkeypatch.undo()
    assert compared(tmp_path, **more)[1] == METHODS


def test_limits_that_were_found_are_not_searched_again(tmp_path, monkeypatch):
    asked = {"methods": METHODS, "output": tmp_path, "threads": 1}
    found, stops = [], ["heun"]
    row = {"cells": 2, "rate": 1.0, "control": "step", "setting": 1.0, "theory": float("inf"),
           "of_theory": float("nan"), "of_euler": 1.0, "kind": "stable", "words": "", "steps": 1,
           "wall": 0.5}  # fmt: skip

    def rows(state, method, patience):
        if method.name in stops:
            stops.remove(method.name)
            raise KeyboardInterrupt
        found.append(method.name)
        return [{"method": method.name, **row}]

    monkeypatch.setattr(search, "_rows", rows)
    monkeypatch.setattr(search, "settled_state", lambda *_: None)
    with pytest.raises(KeyboardInterrupt):
        stability(SCENE, **asked)
    assert found == ["euler"]
    monkeypatch.setattr(html, "write_page", full)
    with pytest.raises(OutputError, match="cannot write"):
        stability(SCENE, **asked)
    monkeypatch.setattr(html, "write_page", lambda path, *_, **__: path)
    made = stability(SCENE, **asked)
    assert found == ["euler", "heun"]
    assert [row["method"] for row in made.table] == METHODS
    assert [row["theory"] for row in made.table] == [float("inf")] * 2
    assert not (tmp_path / LOG_FILE).exists()
