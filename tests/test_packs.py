"""Packs of compiled kernels: used where they fit, with the same bits; everything else compiles."""

import hashlib
import json
import os
import platform
import shutil
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path
from zipfile import ZipFile

import pytest
from click.testing import CliRunner

import multicell as mc
from multicell.cli.main import main
from multicell.compiling import numba_068
from multicell.compiling import pack as packs
from multicell.compiling.kernels import build_pack
from multicell.compiling.numba_068 import processor
from multicell.compiling.pack import PROCESSOR_LEVELS, Pack, setting
from multicell.errors import ExitCode
from multicell.host import closed

LEVEL = "x86-64-v2" if platform.machine() == "x86_64" else "generic"
CHANGES = {"duration": "1 min", "initial.count": 20}
ONE_CELL = ("growth", {"duration": "1 min"})  # needs random numbers alone, so that little compiles

PROGRAM = """
import hashlib, json, sys
import multicell as mc
from multicell.compiling.numba_068 import install_recorder, installed_pack, processor
scene, changes = json.loads(sys.argv[1])
with install_recorder("numba:compile") as record:
    result = mc.run(mc.load_scene(scene).with_changes(changes), threads=1)
pack = installed_pack(processor())
print(json.dumps({
    "compiled": [e.data["dispatcher"].py_func.__name__ for _, e in record.buffer if e.is_start],
    "bits": hashlib.sha256(result.frames[-1].cells.position.tobytes()).hexdigest(),
    "loaded": pack.loaded if pack else 0,
    "refusal": pack.refusal if pack else "",
    "versions": result.summary()["versions"].get("multicell-kernels"),
}))
"""


@pytest.fixture(scope="module")
def environment(tmp_path_factory):
    """Return the Python of an environment with a pack, the folder of that, and the pack's files."""
    folder = tmp_path_factory.mktemp("packed")
    changes = [f"{key}={value}" for key, value in CHANGES.items()]
    wheel = build_pack(folder / "wheels", ["settle"], LEVEL, changes)
    venv.create(folder / "venv", with_pip=False)
    schemes = {name: str(folder / "venv") for name in ("base", "platbase")}
    site = Path(sysconfig.get_path("purelib", vars=schemes))
    (site / "here.pth").write_text("\n".join(path for path in sys.path if path))
    with ZipFile(wheel) as packed:
        packed.extractall(site)
    python = Path(sysconfig.get_path("scripts", vars=schemes)) / Path(sys.executable).name
    return python, site / closed.PACK, folder / "whole"


@pytest.fixture
def packed(environment, tmp_path):
    """Return the folder of a whole pack, and what a run with it on an empty cache does."""
    python, folder, whole = environment
    if not whole.exists():
        shutil.copytree(folder, whole)
    shutil.rmtree(folder)
    shutil.copytree(whole, folder)

    def run(scene=ONE_CELL, **variables):
        others = {k: v for k, v in os.environ.items() if not k.startswith("NUMBA_")}
        done = subprocess.run(
            [python, "-c", PROGRAM, json.dumps(scene)], cwd=tmp_path, capture_output=True,
            text=True, check=True,
            env={**others, "NUMBA_CACHE_DIR": str(tmp_path / "cache"), **variables},
        )  # fmt: skip
        code = [file.name for file in (tmp_path / "cache").rglob("*.nbc")]
        return {**json.loads(done.stdout), "saved": code}

    return folder, run


def _changed(folder, **entries):
    about = json.loads((folder / "about.json").read_text())
    (folder / "about.json").write_text(json.dumps(about | entries))


@pytest.mark.slow
def test_a_run_with_a_pack_compiles_nothing_and_has_the_bits_of_one_without(packed):
    folder, run = packed
    found = run(("settle", CHANGES))
    assert (found["compiled"], found["saved"], found["refusal"]) == ([], [], "")
    assert found["versions"] == LEVEL
    assert 5 < found["loaded"] <= len(list(folder.rglob("*.nbc")))
    here = mc.run(mc.load_scene("settle").with_changes(CHANGES), threads=1)  # for this processor
    assert found["bits"] == hashlib.sha256(here.frames[-1].cells.position.tobytes()).hexdigest()
    assert "multicell-kernels" not in here.summary()["versions"]


@pytest.mark.slow
def test_code_of_the_user_s_own_cache_comes_first(packed):
    _, run = packed
    bare, found = run(MULTICELL_NO_PACK="1"), run()
    assert (bare["loaded"], bare["versions"]) == (0, None)
    assert len(bare["saved"]) > 1
    assert (found["compiled"], found["loaded"], found["bits"]) == ([], 0, bare["bits"])


@pytest.mark.slow
def test_files_that_are_not_as_packed_are_compiled_and_all_others_used(packed, tmp_path):
    folder, run = packed
    whole = run()
    (file,) = (folder / "multicell").glob("philox.philox_blocks-*.nbc")
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    for damaged in (content, content[:-100]):
        file.write_bytes(damaged)
        found = run()
        assert (found["saved"], found["bits"]) == ([file.name], whole["bits"])
        assert found["loaded"] == whole["loaded"] == 1  # what the other one calls, and that itself
        shutil.rmtree(tmp_path / "cache")


@pytest.mark.slow
def test_a_forged_entry_with_its_digest_is_compiled(packed):
    folder, run = packed
    forged = {}
    for file in sorted(folder.rglob("*.nb[ic]")):
        content = b"no pickle" if file.suffix == ".nbc" else file.read_bytes()
        file.write_bytes(content)
        forged[file.relative_to(folder).as_posix()] = hashlib.sha256(content).hexdigest()
    _changed(folder, files=forged)
    found = run()
    assert "cannot be read" in found["refusal"]
    assert (found["loaded"], found["versions"]) == (0, None)
    assert len(found["saved"]) > 1


@pytest.mark.slow
def test_a_pack_of_other_sources_is_as_none(packed):
    folder, run = packed
    _changed(folder, setting={**setting(), "sources": "0123"})
    found = run()
    assert "sources 0123" in found["refusal"]
    assert (found["loaded"], found["versions"]) == (0, None)
    assert len(found["saved"]) > 1


@pytest.fixture
def made(tmp_path):
    """Return a function that makes a pack without files for a level, and opens it."""

    def open_pack(level, own, **entries):
        triple = processor()[0]
        about = {"level": level, "for": [triple, level, ""], "setting": setting(), "files": {}}
        (tmp_path / "about.json").write_text(json.dumps(about | entries))
        return Pack(str(tmp_path), own or processor())

    return open_pack


@pytest.mark.parametrize("level", PROCESSOR_LEVELS)
def test_levels_are_used_by_processors_that_have_their_features(made, level):
    triple = processor()[0]
    needed = [f"+{name}" for name in PROCESSOR_LEVELS[level].split()]
    assert made(level, (triple, "znver9", ",".join([*needed, "+more", "-other"]))).refusal == ""
    assert made(level, (triple, level, "")).refusal == ""
    for lacking in needed:
        features = ",".join(name for name in needed if name != lacking)
        assert f"for {level}" in made(level, (triple, "znver9", features)).refusal


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"setting": {**setting(), "numba": "0.1"}}, "numba 0.1"),
        ({"setting": {**setting(), "Python": "cpython-27"}}, "Python cpython-27"),
        ({"for": ["riscv64-unknown-linux-gnu", "generic", ""]}, "riscv64"),
    ],
)
def test_a_pack_that_does_not_fit_says_why(made, change, said):
    assert said in made("generic", None, **change).refusal


def test_a_pack_without_an_account_of_itself_is_not_used(made, tmp_path):
    for text in ("", "[]", "{}", '{"level": "x86-64-v9"}', "\x00", '{"files": 3}', 1000 * "["):
        made("generic", None)
        (tmp_path / "about.json").write_text(text)
        assert "about.json cannot be read" in Pack(str(tmp_path), processor()).refusal
    assert "cannot be read" in made("generic", None, files=[1]).refusal
    for entries in ({"setting": {}}, {"for": []}, {"for": ["x"]}):
        assert made("generic", None, **entries).refusal


def test_a_pack_that_others_can_write_to_is_not_used(made, tmp_path):
    assert made("generic", None).refusal == ""
    tmp_path.chmod(0o777)
    assert "others can write" in made("generic", None).refusal


def test_a_pack_is_not_looked_for_in_the_working_folder(tmp_path, monkeypatch):
    (tmp_path / closed.PACK).mkdir()
    (tmp_path / closed.PACK / "about.json").touch()
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    assert closed.pack_folder() == ""
    monkeypatch.setattr(closed.site, "getsitepackages", lambda: [str(tmp_path)])
    assert closed.pack_folder() == str(tmp_path / closed.PACK)
    for off in ("1", "true", "yes"):
        monkeypatch.setenv("MULTICELL_NO_PACK", off)
        assert closed.pack_folder() == ""
    for unset in ("", "0", "false", "No", " off "):
        monkeypatch.setenv("MULTICELL_NO_PACK", unset)
        assert closed.pack_folder() == str(tmp_path / closed.PACK)


def test_a_level_that_this_processor_lacks_is_not_built(tmp_path, monkeypatch):
    monkeypatch.setitem(packs.PROCESSOR_LEVELS, "x86-64-v4", "avx9")
    with pytest.raises(SystemExit, match=r"cannot run code for x86-64-v4: \+avx9"):
        build_pack(tmp_path, ["settle"], "x86-64-v4")


@pytest.mark.parametrize(
    ("change", "said"), [({}, ""), ({"setting": {**setting(), "numba": "0.1"}}, "for numba 0.1")]
)
def test_doctor_reports_a_pack_and_why_it_is_not_used(made, monkeypatch, change, said):
    pack = made("generic", None, **change)
    monkeypatch.setattr(numba_068, "installed_pack", lambda processor: pack)
    found = json.loads(CliRunner().invoke(main, ["doctor", "--json"]).stdout)["pack"]
    assert found.startswith(pack.folder)
    assert ("not used" in found) is bool(said)
    assert said in found
    assert "compiled pack" in CliRunner().invoke(main, ["doctor"]).stdout
    monkeypatch.setattr(numba_068, "installed_pack", lambda processor: None)
    assert "compiled pack" not in CliRunner().invoke(main, ["doctor"]).stdout


def test_a_scene_that_is_not_there_ends_the_builder_as_the_command(tmp_path, capfd):
    with pytest.raises(SystemExit) as ended:
        build_pack(tmp_path, ["no-such-scene"], "generic")
    assert ended.value.code == ExitCode.REFUSED
    assert "no-such-scene" in capfd.readouterr().err
