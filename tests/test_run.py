"""Whole runs from the command line and from Python: what is left behind, and exit codes."""

import contextlib
import json
import subprocess
import sys

import h5py
import numpy as np
import pytest
from click.testing import CliRunner

import multicell as mc
from multicell.cli.main import main

QUICK = ["--set", "duration=30 min", "--set", "initial.count=20", "--set", "output.every=10 min"]
PICTURES = {"growth.png", "section.png", "profiles.png"}
FILES = {"scene.toml", "frames.h5", "summary.json", "report.html"}


def multicell(*arguments, check, cwd="."):
    with contextlib.chdir(cwd):
        done = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert done.exit_code == check, done.output
    return done


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("run") / "out"
    command = [sys.executable, "-m", "multicell", "run", "spheroid", "-o", str(out), *QUICK]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    assert "20" in done.stdout
    assert str(out) in done.stdout.replace("\n", "")
    return out


def test_a_run_leaves_scene_frames_summary_and_report(folder):
    assert {entry.name for entry in folder.iterdir()} == FILES | PICTURES
    summary = json.loads((folder / "summary.json").read_text())
    for key in ("cells", "time", "diameter", "necrotic_radius", "viable_rim", "states",
                "integrator", "wall", "ledger", "units", "seed", "versions"):  # fmt: skip
        assert key in summary
    assert summary["cells"] == 20
    assert summary["time"] == 1800.0
    assert summary["ledger"]["relative_remainder"] <= 1e-6
    assert summary["integrator"]["method"] == "auto"
    assert sum(summary["states"].values()) == 20
    assert "interrupted" not in summary


def test_frames_are_flat_arrays_with_offsets(folder):
    with h5py.File(folder / "frames.h5") as file:
        assert file["frames"]["time"].tolist() == [0.0, 600.0, 1200.0, 1800.0]
        offset = file["offsets"]["frames"]
        assert offset.tolist() == [0, 20, 40, 60, 80]
        assert set(file["cells/id"][60:80]) == set(range(20))
        assert file["cells/position"].shape == (80, 3)
        assert file["cells/radius"].attrs["unit"] == "um"
        assert "oxygen" in file["fields"]
        # columns of what most runs do not have
        assert not {"doomed", "damage"} & set(file["cells"])


def test_the_resolved_scene_gives_the_same_bits_in_memory(folder):
    text = (folder / "scene.toml").read_text()
    assert "numpy" in text
    assert "seed = 1" in text
    stored, again = mc.load_result(folder), mc.run(mc.load_scene(folder / "scene.toml"))
    assert again.folder is None
    assert len(stored.frames) == len(again.frames) == 4
    for one, two in zip(stored.frames, again.frames, strict=True):
        for (name, a), (_, b) in zip(one.cells.columns(), two.cells.columns(), strict=True):
            assert np.array_equal(a, b), name
        assert np.array_equal(one.fields["oxygen"].values, two.fields["oxygen"].values)
    assert np.array_equal(stored.history["diameter"], again.history["diameter"])
    assert again.summary()["cells"] == stored.summary()["cells"]


def test_python_surface_of_the_design(tmp_path):
    scene = mc.load_scene("spheroid")
    scene = scene.with_changes({"nutrients.oxygen.boundary": "0.07 mM", "duration": "20 min"})
    seen = []
    result = mc.run(
        scene, output=tmp_path / "out", integrator="euler", progress=lambda s: seen.append(s.time)
    )
    assert seen == [600.0, 1200.0]
    assert result.summary()["integrator"]["method"] == "euler"
    assert len(result.frames[-1].cells) == 1
    assert result.plot.growth() is not None


def test_a_step_that_cannot_be_solved_exits_with_1_and_keeps_the_frames(tmp_path):
    done = multicell(
        "run", "settle", "-o", tmp_path / "o", "--set", "integrator=euler",
        "--set", "integrator.step=1 h", "--set", "coupling_step=1 h", check=1,
    )  # fmt: skip
    assert "cell " in done.stderr
    assert "t = 0 s" in done.stderr
    assert "shorter integrator.step" in done.stderr
    result = mc.load_result(tmp_path / "o")
    assert len(result.frames) == 1
    assert len(result.frames[0].cells) == 200
    assert result.summary()["interrupted"] is True


SMALL = ["settle", "--set", "initial.count=8", "--set", "duration=2 min", "--json"]
COMMANDS = {
    "run": (["--no-report"], lambda told: told["cells"] == 8, "summary.json"),
    "compare": (
        ["--methods", "euler,cvode", "--repeats", "1", "--budget", "2"],
        lambda told: min(row["error_position"] or 1 for row in told) < 1e-4, "workprecision.png",
    ),
    "stability": (
        ["--methods", "euler"], lambda told: {row["method"] for row in told} == {"euler"},
        "stability.png",
    ),
}  # fmt: skip


@pytest.mark.parametrize("command", COMMANDS)
def test_json_is_one_document_beside_the_files(command, tmp_path):
    more, right, file = COMMANDS[command]
    done = multicell(command, *SMALL, *more, "-o", tmp_path / "o", check=0)
    assert right(json.loads(done.stdout))
    assert (tmp_path / "o" / file).stat().st_size > 0


def test_existing_folder_is_refused_and_overwritten_on_request(folder, tmp_path):
    out = tmp_path / "o"
    arguments = ["run", "settle", "-o", out, "--no-report", "--set", "duration=1 min",
                 "--set", "initial.count=5"]  # fmt: skip
    multicell(*arguments, check=0)
    (out / "mine.txt").write_text("keep")
    refused = multicell(*arguments, check=2)
    assert "not empty" in refused.stderr
    assert "--overwrite" in refused.stderr
    multicell(*arguments, "--overwrite", check=0)
    assert (out / "mine.txt").read_text() == "keep"
