"""The study on a cluster with Slurm, as far as a machine without Slurm can run it."""

import os
import sys
from pathlib import Path

import pytest
from example_programs import load
from studied import SHORT

import multicell as mc

dask_jobqueue = pytest.importorskip("dask_jobqueue")
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the name of a network of Linux")


def test_jobs_have_one_process_a_core_with_one_thread(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    options = ["--queue", "compute", "--account", "me", "--cores", "16", "--memory", "48 GB"]
    more = ["--walltime", "12:00:00", "--interface", "lo", "--show"]
    assert load("slurm_study").main(["study", *options, *more]) is None
    script = capsys.readouterr().out
    for line in ("-p compute", "-A me", "--cpus-per-task=16", "-t 12:00:00"):
        assert f"#SBATCH {line}" in script
    command = script.splitlines()[-2]
    assert sys.executable in command
    for option in ("--nthreads 1 ", "--nworkers 16 ", "--preload multicell.studies.workers"):
        assert option in command
    assert not (tmp_path / "study").exists()


SBATCH = """#!/bin/sh
exec 3<"$1"  # it is removed as soon as this ends
setsid sh <&3 >/dev/null 2>&1 &
echo "Submitted batch job $!"
"""
SCANCEL = """#!/bin/sh
kill -KILL -- "-$1"
"""


@pytest.fixture
def slurm(tmp_path, monkeypatch):
    """Two commands of Slurm that know this machine only."""
    place = tmp_path / "bin"
    place.mkdir()
    for name, text in {"sbatch": SBATCH, "scancel": SCANCEL}.items():
        (place / name).write_text(text)
        (place / name).chmod(0o755)
    package = str(Path(mc.__file__).parents[1])
    monkeypatch.setenv("PATH", os.pathsep.join([str(place), os.environ["PATH"]]))
    monkeypatch.setenv("PYTHONPATH", package)
    monkeypatch.chdir(tmp_path)


@pytest.mark.slow
@pytest.mark.usefixtures("slurm")
def test_jobs_carry_a_study_out(tmp_path, capsys):
    example = load("slurm_study")
    scene = mc.load_scene("growth").with_changes(SHORT)
    study = mc.study(scene, vary={"cells.young": "1,2 kPa"}, seeds=2, output=tmp_path / "study")
    with example.cluster("compute", 1, "2 GB", "1:00:00", interface="lo") as jobs:
        example.carried_out(study, jobs, 2)
    assert "4 of 4 runs are done" in capsys.readouterr().out
    assert {found.state for found in study.status()} == {"done"}
