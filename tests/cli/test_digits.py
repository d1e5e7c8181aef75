"""Numbers of thousands of digits, which Python refuses to read, end in words at every door."""

from pathlib import Path

import pytest
import tomli_w
from click.testing import CliRunner

from multicell.cli.main import main
from multicell.integrators.registry import find
from multicell.units import whole_number

LONG = "7" * 5000
FIT = ["fit", "growth", "--data", "data.csv", "-o", "out", "--free", "growth.cycle_time=10:20 h"]
CELLS = ["run", "growth", "-o", "out", "--set", "initial.cells=data.csv"]
SCENE = ["explain", "scene.toml"]
DOORS = {
    "data": (FIT, f"day,cells\n1,{LONG}\n2,3\n"),
    "times of data": (FIT, f"day,cells\n{LONG},4\n2,3\n"),
    "numbered data": (FIT, f",day,cells\n{LONG},1,4\n{LONG},2,5\n"),
    "a type": (CELLS, f"x_um,y_um,z_um,type\n1,0,0,a\n15,0,0,{LONG}\n"),
    "an identity": (CELLS, f"x_um,y_um,z_um,id\n1,0,0,{LONG}\n15,0,0,1\n"),
    "a count": (SCENE, {"initial": {"count": LONG}}),
    "thousands": (SCENE, {"initial": {"count": f"{LONG}k"}}),
    "a quantity": (SCENE, {"cells": {"division_radius": f"{LONG} um"}}),
    "a method": (SCENE, {"integrator": f"rkc2-{LONG}"}),
    "a value on the line": (["explain", "growth", "--set", f"seed={LONG}"], ""),
    "a formula": (SCENE, {"nutrients": {"a": {"regime": "transient", "initial_formula": LONG}}}),
}


@pytest.mark.parametrize("door", DOORS)
def test_every_door_refuses_them_in_words(door, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    arguments, content = DOORS[door]
    if isinstance(content, dict):
        entries = {"duration": "1 h", **content}
        Path("scene.toml").write_text(tomli_w.dumps(entries), "utf-8")
    else:
        Path("data.csv").write_text(content, "utf-8")
    answer = CliRunner().invoke(main, arguments)
    assert answer.exit_code == 2, answer.output
    assert answer.stderr.count("Error") == 1
    assert max(map(len, answer.stderr.splitlines())) < 500


@pytest.mark.parametrize(
    ("text", "number"),
    [("0", 0), ("007", 7), (str(2**63 - 1), 2**63 - 1), (str(2**63), None), (LONG, None),
     ("0" * 5000 + "3", 3), ("-1", None), ("1.0", None), ("", None), ("²", None), ("٣", 3)],
)  # fmt: skip
def test_a_whole_number_is_one_of_64_bits(text, number):
    assert whole_number(text) == number


def test_a_variant_of_a_method_has_a_number():
    assert find("rkc2-5") is not None
    assert find(f"rkc2-{LONG}") is None
