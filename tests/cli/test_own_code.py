"""Faults in code of the user's are told with file, line and likely name, and are no bug of ours."""

from __future__ import annotations

import math
import re
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

import multicell as mc
from multicell.cli.main import main

HERE = Path(__file__).name
HEAD = "import math\nimport multicell as mc\nfrom beside import scaled\n"
LAW = '@mc.pair_law(parameters={"stiffness": "nN/um"})\ndef law(overlap, modulus, radius, p):\n'
METHOD = (
    "class Method:\n"
    '    info = mc.MethodInfo("mine", "a method of my own", order=1)\n'
    "    def integrate(self, system, position):\n"
)
FAULTS = {
    "a name": (LAW, "    return p.stiffness * overlp", "NameError", "overlap"),
    "a name in a branch": (
        LAW, "    return p.stiffness * overlap if overlap < 1e6 else overlp", "TypingError",
        "overlap",
    ),
    "a parameter": (LAW, "    return p.stifness * overlap", "which is not declared", "stiffness"),
    "an exception": (LAW, "    raise ValueError('not today')", "ValueError: not today", ""),
    "two results": (LAW, "    return p.stiffness * overlap, 1.0", "The force is one number", ""),
    "a method's name": (METHOD, "        return system.velocty(0.0, position)",
                        "AttributeError", "velocity"),
    "a file beside": (METHOD, "        return scaled(position)", "NameError", "factor"),
}  # fmt: skip


def called(folder, head, line):
    """Run a law or a method of a file by the command; return its answer and where the fault is."""
    (folder / "beside.py").write_text("factor = 2.0\ndef scaled(x):\n    return x * factr\n")
    sys.modules.pop("beside", None)
    text = HEAD + head + line + "\n"
    own = folder / "own.py"
    own.write_text(text)
    option = ("--law", f"{own}:law") if head is LAW else ("--integrator", f"{own}:Method")
    arguments = ["run", "settle", *option, "--set", "initial.count=3", "--set", "duration=60 s"]
    if head is LAW:
        arguments += ["--set", "contact.stiffness=1"]
    answer = CliRunner().invoke(main, [*arguments, "-o", str(folder / "out"), "--no-report"])
    where = (folder / "beside.py", 3) if "scaled" in line else (own, len(text.splitlines()))
    return answer, where


@pytest.mark.parametrize("case", FAULTS)
def test_the_command_names_file_line_and_likely_name(case, tmp_path):
    head, line, said, meant = FAULTS[case]
    answer, (file, number) = called(tmp_path, head, line)
    text = " ".join(answer.stderr.split())
    assert answer.exit_code in (1, 2)
    assert "bug of multicell" not in text
    assert said in text
    if "one number" in said:
        number -= 2  # where the function begins, with its decorator
    assert f"'{file}', line {number}, " in text
    if meant:
        assert f"did you mean '{meant}'?" in text


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        (lambda u: u * missng, "NameError: name 'missng' is not defined"),  # noqa: F821
        (lambda u: math.sqr(u), "no attribute 'sqr' (did you mean 'sqrt'"),
        (lambda u: u if u < 1e6 else missng, "NameError: name 'missng'"),  # noqa: F821
    ],
)
def test_a_reaction_is_refused_with_its_line(fault, said):
    def rate(concentrations, cell):
        return (-fault(concentrations[0]),)

    with pytest.raises(mc.SceneError, match=rf"{HERE}', line \d+") as refused:
        mc.reaction(fields=("u",))(rate)
    assert said in str(refused.value)


def test_an_error_of_a_callback_comes_back_as_it_is(tmp_path):
    def progress(simulation):
        return simulation.tme

    scene = mc.load_scene("settle").with_changes({"initial.count": 3, "duration": "60 s"})
    with pytest.raises(AttributeError, match="tme") as raised:
        mc.run(scene, progress=progress, output=tmp_path / "out", report=False)
    assert raised.traceback[-1].path.name == HERE
    assert mc.load_result(tmp_path / "out").summary()["interrupted"]


def test_what_is_no_code_of_the_users_is_a_bug_of_ours(monkeypatch, tmp_path):
    def broken(*arguments, **options):
        raise KeyError("x")

    monkeypatch.setattr("multicell.runner.Simulation", broken)
    answer, _ = called(tmp_path, LAW, "    return p.stiffness * overlap")
    assert "bug of multicell" in answer.stderr
    assert re.search("own.py", answer.stderr) is None


BOTH = """
import multicell as mc


@mc.pair_law(parameters={"stiffness": "nN/um"})
def law(overlap, modulus, radius, p):
    return p.stiffness * max(overlap, 0.0)


@mc.pair_law(parameters={"stiffness": "nN/um"})
def other(overlap, modulus, radius, p):
    return 2.0 * p.stiffness * max(overlap, 0.0)


@mc.growth_law(parameters={})
def steady(volume, p):
    return 1.0 + 0.1 * volume


@mc.response(parameters={"half": "mM"})
def half_way(signal, p):
    return signal / (p.half + signal)
"""


def explained(file, *names):
    """Explain a scene with laws of a file."""
    laws = [word for name in names for word in ("--law", f"{file}:{name}")]
    own = ["--set", "contact.stiffness=1", "--set", "duration=1 h"]
    return CliRunner().invoke(main, ["explain", "growth", *laws, *own, "--json"])


def test_several_laws_are_named_at_once(tmp_path):
    file = tmp_path / "both.py"
    file.write_text(BOTH)
    answer = explained(file, "law", "steady", "half_way")
    assert answer.exit_code == 0, answer.output
    for name in ("law", "steady"):
        assert f"both.py:{name}" in answer.output
    twice = explained(file, "law", "law")
    assert twice.exit_code == 0, twice.output
    answer = explained(file, "law", "other")
    assert answer.exit_code == 2
    assert "two laws for contact.law" in " ".join(answer.output.split())
