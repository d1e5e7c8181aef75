"""Words that people type in place of a command's own: the message states the right ones."""

import sys

import pytest
from click.testing import CliRunner

import multicell as mc
from multicell.cli.main import _ELSEWHERE, _TASKS, main
from multicell.cli.options import known_methods, known_scenes
from multicell.cli.process import _with_hint

LAW = """
import numpy as np
import multicell as mc


def law(function):
    return mc.pair_law(parameters={"stiffness": "nN/um"})(function)


@law
def Where(overlap, modulus, radius, p):
    return np.where(overlap > 0, p.stiffness * overlap, 0.0)


@law
def Typo(overlap, modulus, radius, p):
    return p.stifness * overlap


@law
def Other(overlap, modulus, radius, p):
    return p.kk * overlap


@law
def Sign(overlap, modulus, radius, p):
    return -p.stiffness * overlap
"""
SMALL = ["--set", "initial.count=10", "--set", "duration=2 min", "--no-report", "--quiet"]


def said(arguments, monkeypatch):
    """Return exit code and what a command line says on stderr and stdout, in one line."""
    monkeypatch.setattr(sys, "argv", ["multicell", *arguments])
    answer = CliRunner().invoke(main, arguments)
    return answer.exit_code, " ".join(answer.output.split())


@pytest.mark.parametrize(
    ("law", "words"),
    [
        ("Where", ["line 10, returns array(float64, 0d, C), must return a number", "where"]),
        ("Typo", ["asks for the parameter 'stifness'", "did you mean 'stiffness'?"]),
        ("Other", ["asks for the parameter 'kk', which is not declared", "declared: stiffness"]),
        ("Sign", ["contact.law: gives a force of -", "change the sign of the law"]),
    ],
)
def test_a_law_that_cannot_be_used_is_named_with_what_is_wrong(law, words, tmp_path, monkeypatch):
    (tmp_path / "laws.py").write_text(LAW, "utf-8")
    spec = ["--law", f"{tmp_path / 'laws.py'}:{law}", "--set", "contact.stiffness=2"]
    code, text = said(["run", "settle", *spec, "-o", str(tmp_path / "out"), *SMALL], monkeypatch)
    assert code in (1, 2)
    assert "Constants_" not in text
    assert "surface_energy" not in text
    assert len(text) < 400
    for part in words:
        assert part in text


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["explain", "settle", "--set", "initial.cells=100"], "number of cells is initial.count"),
        (["explain", "settle", "--set", "initial.count=many"], "For example 100"),
        (["explain", "settle", "--set", "a=1", "b=2"], "an option of its own: --set b=2"),
        (["explain", "settle", "--set", "a=1", "b=2", "c=3"], "own: --set b=2 --set c=3"),
        (["explain", "spheroid", "--set", "O2=5 %"], "mean 'nutrients.oxygen.boundary'"),
        (["explain", "spheroid", "--set", "oxygen=5 %"], "mean 'nutrients.oxygen.boundary'"),
        (["explain", "spheroid", "--set", "cycle_time=5 h"], "mean 'growth.cycle_time'"),
        (["explain", "settle", "--set", "cycle_time=5 h"], "mean 'growth.cycle_time'"),
        (["explain", "settle", "--set", "initial=5"], "Its keys: count, cells, shape"),
        (["explain", "settle", "--duration", "5 d"], "a key of the scene: --set duration='…'"),
        (["explain", "settle", "--cycle-time", "5 d"], "--set growth.cycle_time='…'"),
        (["dose-response", "spheroid", "--dose", "cisplatin=0:10", "uM", "-o", "x"], "in quotes"),
        (["dose-response", "spheroid", "--dose", "cisplatin=0,1,2,3 uM", "-o", "x"],
         "the scene has no field 'cisplatin'; its fields: oxygen"),
        (["dose-response", "spheroid", "--dose", "nutrients.drug.boundary=0,1 uM", "-o", "x"],
         "add [nutrients.drug] to the scene"),
        (["dose-response", "spheroid", "--dose", "oxygen=0,1,2 uM", "-o", "x"],
         "For example nutrients.oxygen.boundary"),
        (["run", "settle", "--integrator", "bdf", "-o", "x"], "Did you mean 'cvode'?"),
        (["run", "settle", "--integrator", "ode45", "-o", "x"], "Did you mean 'dopri5'?"),
        (["compare", "settle", "--methods", "explicit", "-o", "x"], "The explicit ones are auto"),
        (["compare", "settle", "--methods", "implicit", "-o", "x"], "The implicit ones are cvode"),
        (["explain", "settle", "--jason"], "--json"),
        (["help", "run"], "No such command 'help': multicell run --help"),
        (["version"], "No such command 'version': multicell --version"),
        (["run", "settle", "-out", "x"], "two hyphens: --output"),
        (["run", "settle", "-o", "x", "--seed", "abc"], "'abc' must be a whole number"),
        (["run", "settle", "-o", "x", "--threads", "0"], "0 must be at least 1"),
        (["play", "settle", "--port", "70000"], "70000 must be from 0 to 65535"),
        (["explain", "settle", "--set", "initial.count=1e3"], "whole number. Write 1000"),
        (["explain", "settle", "--set", "initial.count=1,000"], "whole number. Write 1000"),
        (["explain", "settle", "--set", "initial.count=10k"], "whole number. Write 10000"),
        (["study", "new", "growth", "-o", "x", "--vary", "growth.cycle_time=15..25 h"],
         "which is a range. List the values"),
    ],
)  # fmt: skip
def test_the_message_says_what_was_meant(arguments, words, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    code, text = said(arguments, monkeypatch)
    assert code == 2
    assert words in text


def test_two_scenes_are_not_taken_for_a_value_with_a_space(monkeypatch):
    code, text = said(["run", "settle", "growth", "-o", "x"], monkeypatch)
    assert (code, "(growth)" in text, "quotes" in text) == (2, True, False)
    code, text = said(["run", "settle", "--set", "duration=5", "d", "-o", "x"], monkeypatch)
    assert (code, "stands in quotes, as '… d'" in text) == (2, True)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('duration = "1 d"\nduration = "2 d"', "stands there twice"),
        ('{"duration": "1 d"}', "A scene is TOML, not JSON"),
        ('duration = "1 d', "ends with its quote on the same line: 'duration = \"1 d'"),
        ('duration = "1 d",', "No comma stands at the end of a line"),
        ('duration = "1 d"\n[growth]\nphases = ["G1"]', "Its entries have names: NAME = VALUE"),
        (
            'duration = "1 d"\n[nutrients.oxygen]\nmedia = [["1 d"], ["2 d", "1 mM"]]',
            "has the entry ['1 d'], must be a list of [time, value]",
        ),
    ],
)
def test_slips_in_a_scene_file_are_named(text, words, tmp_path, monkeypatch):
    (tmp_path / "mine.toml").write_text(text + "\n", "utf-8")
    code, found = said(["explain", str(tmp_path / "mine.toml")], monkeypatch)
    assert code == 2
    assert words in found


def test_slips_in_python_are_named():
    with pytest.raises(mc.SceneError, match=r"no method is called 'eulr'\. Did you mean 'euler'"):
        mc.compare("settle", "heun,eulr")
    with pytest.raises(mc.SceneError, match="a scene without a name"):
        mc.load_scene("")
    law = mc.pair_law(parameters={"stiffness": "newton/um"})
    with pytest.raises(mc.SceneError, match="unknown unit 'newton/um'"):
        law(lambda overlap, modulus, radius, p: p.stiffness * overlap)


def test_a_folder_in_the_place_of_a_scene_is_known_as_one(tmp_path, monkeypatch):
    (tmp_path / "runs").mkdir()
    folder = str(tmp_path / "runs")
    code, text = said(["explain", folder], monkeypatch)
    assert (code, "is a folder, not a scene. Name a file in it" in text) == (2, True)
    (tmp_path / "runs" / "scene.toml").write_text("duration = '1 d'\n", "utf-8")
    code, text = said(["explain", folder], monkeypatch)
    assert (code, f"'multicell resume {folder}' continues it" in text) == (2, True)


def test_a_budget_that_is_too_small_is_answered_with_one_that_is_not(tmp_path, monkeypatch):
    (tmp_path / "d.csv").write_text("time / h,diameter / um\n0,10\n24,20\n", "utf-8")
    fit = ["fit", "growth", "--free", "growth.cycle_time=8:25 h", "--data", str(tmp_path / "d.csv")]
    code, text = said([*fit, "-o", str(tmp_path / "f"), "--budget", "12"], monkeypatch)
    assert code == 2
    assert "Give at least 38 runs, for 10 sets" in text


def test_other_complaints_stay_as_they_are():
    import click

    plain = click.UsageError("Missing argument 'SCENE'.")
    assert _with_hint(plain) is plain
    other = click.NoSuchOption("--nothing")
    assert _with_hint(other) is other


def test_every_command_has_its_place_in_the_help():
    listed = [name for names in _TASKS.values() for name in names]
    assert sorted(listed) == sorted({*main.commands, *_ELSEWHERE})
    text = CliRunner().invoke(main, ["--help"]).output
    places = [text.index(f"\n{task}:") for task in _TASKS]
    assert places == sorted(places)
    assert "..." not in text.partition("Run a scene:")[2]
    assert "Other commands" not in text


def completed(monkeypatch, *words):
    monkeypatch.setenv("_MULTICELL_COMPLETE", "bash_complete")
    monkeypatch.setenv("COMP_WORDS", " ".join(["multicell", *words]))
    monkeypatch.setenv("COMP_CWORD", str(len(words)))
    answer = CliRunner().invoke(main, [], prog_name="multicell", complete_var="_MULTICELL_COMPLETE")
    return [line.partition(",")[2] for line in answer.output.splitlines()]


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (["run", "sph"], ["spheroid"]),
        (["explain", "spheroid", "--set", "growth.cycle_t"], ["growth.cycle_time="]),
        (["run", "settle", "--integrator", "cvode-a"], ["cvode-adams"]),
        (["compare", "settle", "--methods", "euler,rkc"], ["euler,rkc2"]),
        (["plot", "out", "--quantity", "diam"], ["diameter"]),
        (["export", "out", "--format", "par"], ["parquet"]),
        (["run", "settle", "--set", "nonsense"], [""]),
    ],
)
def test_shells_complete_names(words, found, monkeypatch):
    assert completed(monkeypatch, *words) == found


def test_all_names_are_offered_and_files_where_no_name_fits(monkeypatch):
    assert set(completed(monkeypatch, "run", "s")) < set(known_scenes())
    assert {"cvode", "auto"} <= set(known_methods())
    assert completed(monkeypatch, "run", "mine.to") == ["mine.to"]
