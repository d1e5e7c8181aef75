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

from multicell.compiling import pack as packs
from multicell.compiling.numba_068 import processor
from multicell.compiling.pack import LEVELS, Pack, setting
from multicell.host import closed
from multicell.kernels import build_pack

LEVEL = "x86-64-v2" if platform.machine() == "x86_64" else "generic"
SCENE, CHANGES = "settle", {"duration": "1 min", "initial.count": 20}

PROGRAM = f"""
import hashlib, json
import multicell as mc
from multicell.compiling.numba_068 import install_recorder, installed_pack, processor
with install_recorder("numba:compile") as record:
    result = mc.run(mc.load_scene("{SCENE}").with_changes({CHANGES}), threads=1)
pack = installed_pack(processor())
print(json.dumps({{
    "compiled": [e.data["dispatcher"].py_func.__name__ for _, e in record.buffer if e.is_start],
    "bits": hashlib.sha256(result.frames[-1].cells.position.tobytes()).hexdigest(),
    "loaded": pack.loaded if pack else 0,
    "refusal": pack.refusal if pack else "",
    "versions": result.summary()["versions"].get("multicell-kernels"),
}}))
"""


@pytest.fixture(scope="module")
def environment(tmp_path_factory):
    """Return the Python of an environment with a pack, the folder of that, and the pack's files."""
    folder = tmp_path_factory.mktemp("packed")
    changes = [f"{key}={value}" for key, value in CHANGES.items()]
    wheel = build_pack(folder / "wheels", [SCENE], LEVEL, changes)
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

    def run(**variables):
        shutil.rmtree(tmp_path / "cache", ignore_errors=True)
        others = {k: v for k, v in os.environ.items() if not k.startswith("NUMBA_")}
        done = subprocess.run(
            [python, "-c", PROGRAM], cwd=tmp_path, capture_output=True, text=True, check=True,
            env={**others, "NUMBA_CACHE_DIR": str(tmp_path / "cache"), **variables},
        )  # fmt: skip
        return json.loads(done.stdout)

    return folder, run


def _changed(folder, **entries):
    about = json.loads((folder / "about.json").read_text())
    (folder / "about.json").write_text(json.dumps(about | entries))
    return about


@pytest.mark.slow
def test_a_run_with_a_pack_compiles_nothing_and_has_the_bits_of_one_without(packed, tmp_path):
    _, run = packed
    found, bare = run(), run(MULTICELL_NO_PACK="1")
    assert (found["compiled"], found["refusal"], found["versions"]) == ([], "", LEVEL)
    assert (bare["loaded"], bare["versions"]) == (0, None)
    assert found["loaded"] == len(bare["compiled"]) > 5
    assert found["bits"] == bare["bits"]
    assert len(list((tmp_path / "cache").rglob("*.nbc"))) == found["loaded"]  # of the bare run


@pytest.mark.slow
def test_code_of_the_user_s_own_cache_comes_first(packed, tmp_path, monkeypatch):
    _, run = packed
    run(MULTICELL_NO_PACK="1")
    monkeypatch.setattr(shutil, "rmtree", lambda *_, **__: None)  # the cache stays
    found = run()
    assert (found["compiled"], found["loaded"]) == ([], 0)


@pytest.mark.slow
def test_files_that_are_not_as_packed_are_compiled_and_all_others_used(packed):
    folder, run = packed
    whole = run()
    first, second, *_ = sorted(folder.rglob("*.nbc"))
    index = next(file for file in sorted(folder.rglob("*.nbi"), reverse=True))
    first.write_bytes(first.read_bytes()[:-100])
    content = bytearray(second.read_bytes())
    content[len(content) // 2] ^= 1
    second.write_bytes(content)
    index.unlink()
    found = run()
    names = [file.name.split(".")[1].rsplit("-", 1)[0] for file in (first, second, index)]
    assert sorted(found["compiled"]) == sorted(names)
    assert (found["loaded"], found["bits"]) == (whole["loaded"] - 3, whole["bits"])


@pytest.mark.slow
def test_a_forged_entry_with_its_digest_is_compiled(packed):
    folder, run = packed
    forged = {}
    for number, file in enumerate(sorted(folder.rglob("*.nb[ic]"))):
        content = b"no pickle" if number % 2 else b"cno_such_module\nfunction\n."
        file.write_bytes(content)
        forged[file.relative_to(folder).as_posix()] = hashlib.sha256(content).hexdigest()
    _changed(folder, files=forged)
    found = run()
    assert "cannot be read" in found["refusal"]
    assert found["loaded"] == 0
    assert len(found["compiled"]) > 5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"setting": {**setting(), "sources": "0123"}}, "sources 0123"),
        ({"setting": {**setting(), "numba": "0.1"}}, "numba 0.1"),
        ({"for": ["riscv64-unknown-linux-gnu", LEVEL, ""]}, "riscv64"),
    ],
)
def test_a_pack_that_does_not_fit_is_as_none(packed, change, said):
    folder, run = packed
    _changed(folder, **change)
    found = run()
    assert said in found["refusal"]
    assert (found["loaded"], found["versions"]) == (0, None)
    assert len(found["compiled"]) > 5


@pytest.fixture
def made(tmp_path):
    """Return a function that makes a pack without files for a level, and opens it."""

    def open_pack(level, own, **entries):
        triple = processor()[0]
        about = {"level": level, "for": [triple, level, ""], "setting": setting(), "files": {}}
        (tmp_path / "about.json").write_text(json.dumps(about | entries))
        return Pack(str(tmp_path), own or processor())

    return open_pack


@pytest.mark.parametrize("level", LEVELS)
def test_levels_are_used_by_processors_that_have_their_features(made, level):
    triple = processor()[0]
    needed = [f"+{name}" for name in LEVELS[level].split()]
    assert made(level, (triple, "znver9", ",".join([*needed, "+more", "-other"]))).refusal == ""
    assert made(level, (triple, level, "")).refusal == ""
    for lacking in needed:
        features = ",".join(name for name in needed if name != lacking)
        assert f"for {level}" in made(level, (triple, "znver9", features)).refusal


def test_a_pack_without_an_account_of_itself_is_not_used(made, tmp_path):
    for text in ("", "[]", "{}", '{"level": "x86-64-v9"}', "\x00", '{"files": 3}'):
        made("generic", None)
        (tmp_path / "about.json").write_text(text)
        assert "about.json cannot be read" in Pack(str(tmp_path), processor()).refusal
    assert "cannot be read" in made("generic", None, files=[1]).refusal
    assert "cannot be read" in made("generic", None, setting={}).refusal


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
    monkeypatch.setenv("MULTICELL_NO_PACK", "1")
    assert closed.pack_folder() == ""


def test_a_level_that_this_processor_lacks_is_not_built(tmp_path, monkeypatch):
    monkeypatch.setitem(packs.LEVELS, "x86-64-v4", "avx9")
    with pytest.raises(SystemExit, match=r"cannot run code for x86-64-v4: \+avx9"):
        build_pack(tmp_path, [SCENE], "x86-64-v4")
