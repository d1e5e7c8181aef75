"""Results of the documentation's own extensions of Sphinx."""

import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest
from page_commands import ROOT

import multicell as mc
from multicell.scene.json_schema import json_schema

pytest.importorskip("sphinx", reason="pages are built with multicell[docs]")


@pytest.fixture
def extension(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "extensions"))
    return importlib.import_module


def test_pages_that_load_from_a_network_are_found(extension):
    loads_of = extension("offline").loads_of
    page = """<link rel="stylesheet" href="https://a/x.css"><link rel="canonical" href="https://b/">
        <script src="//c/x.js"></script><img src="x.png" srcset="y.png 1x, https://d/z.png 2x">
        <a href="https://e/">e</a><p style="background: url('http://f/x.png')"></p>
        <style>@import "https://g/x.css"; p { color: red }</style> url(https://h/)"""
    assert loads_of(page) == [
        "https://a/x.css", "//c/x.js", "https://d/z.png", "http://f/x.png", "https://g/x.css",
    ]  # fmt: skip


def test_tables_of_keys_have_every_key_of_a_scene(extension):
    keys = list(extension("scene_keys").keys())
    schema = json_schema()

    def leaves(part, path):
        part = schema["$defs"][part["$ref"].rpartition("/")[2]] if "$ref" in part else part
        inside = part.get("properties", {})
        first = next(iter(inside.values()), {})
        if "$ref" in first and all(inner == first for inner in inside.values()):
            # tables of one kind by names that are given
            yield from leaves(first, f"{path}NAME.")
            return
        for name, inner in inside.items():
            yield f"{path}{name}"
            yield from leaves(inner, f"{path}{name}.")
        if isinstance(part.get("additionalProperties"), dict):
            yield from leaves(part["additionalProperties"], f"{path}NAME.")
        for case in part.get("anyOf", []):
            yield from leaves(case, path)

    needed = set(leaves(schema, ""))
    assert len(needed) > 150
    # the key that says which part a table is stands in the heading of each
    assert {key for key in needed - set(keys) if not key.endswith(".law")} == set()
    assert "duration" in keys
    assert "nutrients.NAME.boundary" in keys


def test_rows_have_unit_default_and_range(extension):
    page = extension("scene_keys").page()
    line = next(line for line in page.splitlines() if line.startswith("| `division_radius`"))
    assert line == (
        "| `division_radius` | quantity | um | `5.0` | above 0 um | At which a cell divides; "
        "newborn cells, and all without growth, have 0.794 of it |"
    )
    assert '## `[contact]` with `law = "jkr"`' in page


def test_every_public_name_is_on_a_page_of_the_reference(extension):
    names = set(extension("public_names").public_names())
    text = "\n".join(file.read_text("utf-8") for file in (ROOT / "docs" / "api").glob("*.md"))
    given = set()
    home = "multicell"
    for kind, name in re.findall(r"^\.\. (currentmodule|auto\w+):: ([\w.]+)", text, re.MULTILINE):
        home = name if kind == "currentmodule" else home
        given.add(name if name.startswith("multicell.") else f"{home}.{name}")
    assert names - given == set()
    assert {f"multicell.{name}" for name in mc.__all__} - names == {"multicell.testing"}


def test_programs_that_are_not_run_say_why(extension):
    gallery = extension("gallery")
    shown = {file.name for file in gallery.EXAMPLES.glob("*.py")} - set(gallery.executed())
    assert "slurm_study.py" in shown
    assert "jkr_curves.py" not in shown
    for name in shown:
        after = " ".join(gallery.words(gallery.EXAMPLES / name)).partition(gallery.NOT_RUN)[2]
        assert len(after.split(".")[0].split()) > 2


@pytest.mark.slow
def test_lines_of_cells_that_fail_raise(tmp_path, extension):
    pytest.importorskip("IPython")
    startup = extension("kernel").STARTUP
    profile = tmp_path / "profile_default" / "startup"
    profile.mkdir(parents=True)
    (profile / "00.py").write_text(startup)
    python = [sys.executable, "-m", "IPython", f"--ipython-dir={tmp_path}", "--colors=NoColor"]
    answers = [
        subprocess.run(
            [*python, "-c", f"!exit {code}"], capture_output=True, text=True, check=False
        )
        for code in (0, 3)
    ]
    assert "CalledProcessError" not in answers[0].stdout
    assert "CalledProcessError" in answers[1].stdout


def test_titles_of_examples_are_underlined():
    for file in sorted((ROOT / "examples").glob("*.py")):
        lines = file.read_text("utf-8").splitlines()
        assert lines[1] == "=" * (len(lines[0]) - 3), Path(file).name
