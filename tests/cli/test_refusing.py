"""Cost of refusals: time and memory are bounded for every command."""

import sys
import tomllib

import pytest

import multicell as mc
from multicell.host.files import parse_toml
from multicell.scene.scene import scene_text

DEEP = ".".join("a" * 35_000)
FREE = "growth.cycle_time=8:25 h"
DATA = "time / h,diameter / um\n10,30\n20,40\n30,50\n40,60\n"


def refused(forks, folder, *arguments):
    """Run a command in little memory and time; return the only line that it says."""
    done = forks.multicell(*arguments, folder=str(folder), memory=3 << 29, limit=30.0)
    assert done["code"] == 2, done["text"][-2000:]
    lines = done["text"].strip().splitlines()
    assert "Traceback" not in done["text"]
    assert len(lines[-1]) < 2000
    return lines[-1]


@pytest.mark.parametrize(
    "text",
    [f"{DEEP} = 1", f"[{DEEP}]", f"x = {{ {DEEP} = 1 }}", f"[[{DEEP}]]",
     ".".join(['"a"'] * 35_000) + " = 1", " . ".join(["'a'"] * 35_000) + " = 1"],
    ids=["key", "table", "inline", "tables", "quoted", "spaced"],
)  # fmt: skip
def test_keys_of_thousands_of_parts_are_refused_before_they_are_parsed(text):
    with pytest.raises(ValueError, match="more than 20 parts"):
        parse_toml(text)


@pytest.mark.parametrize(
    "text",
    [f'title = "{DEEP}"', f"title = '''\n{DEEP}'''", f"# {DEEP}\nseed = 1", "a.b.c.d.e.f = 1.5",
     f'title = """a ""b"" {DEEP}\n"""  # {DEEP}', "a = [1.5, 2.5]\n" "b = {c.d = 1}"],
)  # fmt: skip
def test_texts_and_remarks_may_have_as_many_dots_as_they_like(text):
    assert parse_toml(text) == tomllib.loads(text)


def test_scenes_are_read_as_before():
    texts = [scene_text(name) for name in mc.scene_names()]
    assert list(map(parse_toml, texts)) == list(map(tomllib.loads, texts))


KEYS = {
    "explain": ["explain", "deep.toml"],
    "set": ["explain", "growth", "--set", f"{DEEP}=1"],
    "new": ["study", "new", "growth", "--vary", f"{DEEP}=1,2", "-o", "o"],
    "status": ["study", "status", "deep"],
}
FIT = ["fit", "growth", "--data", "data.csv", "--free", FREE, "-o", "o"]
COUNTS = {
    "fit seeds": [*FIT, "--seeds", 10**9],
    "fit cores": [*FIT, "--cores", 10**6],
    "sensitivity runs": ["sensitivity", "growth", "--free", FREE, "-o", "o", "--size", 20_000],
    "study values": ["study", "new", "growth", "-o", "o", "--vary",
                     "growth.cycle_time=1:2:100000h"],
    "study grid": ["study", "new", "growth", "-o", "o", "--vary", "growth.cycle_time=1:2:2000h",
                   "--vary", "drag.viscosity=1:2:2000 kPa s"],
    "study digits": ["study", "new", "growth", "-o", "o", "--vary",
                     f"growth.cycle_time=1:2:{'9' * 6000}h"],
    "study run cores": ["study", "run", "small", "--cores", 10**6],
}  # fmt: skip


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "deep.toml").write_text(f"{DEEP} = 1\n")
    (tmp_path / "deep").mkdir()
    (tmp_path / "deep" / "study.toml").write_text(f"vary.{DEEP} = 1\n")
    (tmp_path / "data.csv").write_text(DATA)
    mc.study("growth", {"cells.young": "1,2 kPa"}, output=tmp_path / "small")
    return tmp_path


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not limit address space")
@pytest.mark.parametrize("name", KEYS)
def test_deep_keys_cost_little(name, forks, folder):
    line = refused(forks, folder, *KEYS[name])
    assert "more than 20 parts" in line
    assert not (folder / "o").exists()


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not limit address space")
@pytest.mark.parametrize("name", COUNTS)
def test_numbers_without_measure_cost_little(name, forks, folder):
    line = refused(forks, folder, *COUNTS[name])
    assert any(words in line for words in ("20,000", "100,000", "cores: is 1000000"))
    assert not (folder / "o").exists()
