"""The commands of studies: what they write and print, what they refuse, exit codes."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest
from click.testing import CliRunner
from rich_medium import RICH
from signals import listening
from studied import SHORT

import multicell as mc
from multicell.cli.main import main
from multicell.cli.progress import Pace
from multicell.studies.engine import RunOutcome
from multicell.studies.runs import StudyRun

SET = [f"--set={key}={value}" for key, value in SHORT.items()]
OXYGEN, LENGTH = "nutrients.oxygen.boundary", "growth.phases.G1.duration"


def call(*arguments, **options):
    return CliRunner().invoke(main, ["study", *map(str, arguments)], **options)


def line(*arguments):
    """Return exit code and all that the command says, in a process of its own."""
    command = [sys.executable, "-m", "multicell", "study", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, stdin=subprocess.DEVNULL)
    return done.returncode, done.stdout, done.stderr


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "study"


def test_every_command_has_help():
    page = call("--help").output
    for command in ("new", "run", "status", "report"):
        assert command in page
        answer = call(command, "--help")
        assert answer.exit_code == 0
        assert "--json" in answer.output


def test_a_new_study_is_written_and_told(folder):
    vary = [f"--vary={OXYGEN}=0.07,0.14,0.28 mM", "--vary=nutrients.glucose.boundary=0.8,1.8 mM"]
    answer = call("new", RICH, "-o", folder, *vary, "--seeds", 5)
    assert answer.exit_code == 0
    for words in (
        f'{OXYGEN} = ["0.07 mM", "0.14 mM", "0.28 mM"]', "6 points x 5 seeds = 30 runs",
        "30 runs left, expected to take about", "of memory", f"multicell study run {folder}",
    ):  # fmt: skip
        assert words in answer.output
    study = mc.load_study(folder)
    assert study.plan.seeds == 5
    assert len(study.runs) == 30
    assert not (folder / "runs").exists()


REFUSED = {
    (f"--vary={OXYGEN}",): "is not KEY=VALUES",
    ("--vary==1",): "is not KEY=VALUES",
    (f"--vary={OXYGEN}=1 mM", f"--vary={OXYGEN}=2 mM"): "is given twice",
    ("--vary=nutrients.oxygen.necrosis=0.001,0.5 mM",):
        "(where nutrients.oxygen.necrosis = '0.5 mM')",
    ("--seeds", "many"): "must be a whole number",
    ("--set", "friction.normal=x"): "friction.normal",
    ("--set", "integrator=eular"): "Did you mean 'euler'",
    ("--law", "absent.py:x"): "there is no file",
}  # fmt: skip


@pytest.mark.parametrize("options", REFUSED)
def test_what_is_no_study_is_refused_before_anything_is_written(folder, options):
    answer = subprocess_free("new", RICH, "-o", folder, *options)
    assert answer[0] == 2
    assert REFUSED[options] in answer[1]
    assert not folder.exists()


def subprocess_free(*arguments):
    """Return exit code and message, by the door of the command but in this process."""
    from multicell.cli.process import exit_code

    given = ["study", *map(str, arguments)]
    runner = CliRunner()
    with runner.isolation() as (out, err, _):
        code = exit_code(lambda: main.main(given, standalone_mode=False), as_json=False)
        sys.stderr.flush()
        said = err.getvalue().decode() + out.getvalue().decode()
    return code, " ".join(said.split())


def test_a_folder_without_a_study_is_told(tmp_path):
    for command in ("run", "status", "report"):
        code, said = subprocess_free(command, tmp_path / "absent")
        assert code == 2
        assert "holds no study" in said


def test_another_study_is_refused_and_overwritten_on_demand(folder):
    assert call("new", RICH, "-o", folder, "--seeds", 3).exit_code == 0
    code, said = subprocess_free("new", "growth", "-o", folder)
    assert (code, "another scene" in said) == (2, True)
    code, said = subprocess_free("new", RICH, "-o", folder, "--seeds", 2)
    assert (code, "not be widened, but changed" in said) == (2, True)
    assert call("new", RICH, "-o", folder, "--seeds", 2, "--overwrite").exit_code == 0


def test_above_an_hour_it_is_asked_and_without_a_terminal_refused(folder):
    long = ["--set=duration=20 d", "--set=stop_cells=1000000", "--seeds", 50]
    assert call("new", RICH, "-o", folder, *long).exit_code == 0
    code, said = subprocess_free("run", folder)
    assert code == 2
    assert "--yes confirms" in said
    assert "50 runs left, expected to take about" in said
    assert not (folder / "runs").exists()


def test_no_is_an_answer(folder, monkeypatch):
    long = ["--set=duration=20 d", "--set=stop_cells=1000000", "--seeds", 50]
    call("new", RICH, "-o", folder, *long)
    monkeypatch.setattr("multicell.cli.study._terminal", lambda: True)
    answer = call("run", folder, input="n\n")
    assert answer.exit_code == 130
    assert "Nothing has run." in answer.output


@pytest.mark.slow
def test_the_whole_chain(folder):
    vary = ["--vary=cells.young=1,2 kPa"]
    assert call("new", "growth", "-o", folder, *SET, *vary).exit_code == 0
    code, out, err = line("run", folder, "--cores", 1)
    assert code == 0, err
    assert "2 runs left, expected to take about" in err
    assert "2 of 2 runs" in err
    assert "2 runs: 2 done." in out
    assert {"report.html", "study.nc", "study.csv"} <= {path.name for path in folder.iterdir()}
    # again: nothing is left to do
    begin = time.process_time()
    answer = call("run", folder)
    assert time.process_time() - begin < 2.0
    assert "2 of them were there" in answer.output
    told = json.loads(call("status", folder, "--json").output)
    assert told["counts"] == {"done": 2}
    assert told["core_seconds_left"] == 0.0
    assert [run["coordinates"]["young"] for run in told["runs"]] == [1.0, 2.0]
    assert "2 runs: 2 done" in call("status", folder).output
    files = json.loads(call("report", folder, "--json").output)["files"]
    assert [os.path.exists(file) for file in files] == [True] * 3


@pytest.mark.slow
def test_a_run_that_fails_is_told_with_its_reason(folder):
    few = [*SET, "--set=integrator.max_steps=1", "--set=integrator=cvode", "--seeds", 1]
    assert call("new", "growth", "-o", folder, *few, "--vary=cells.young=1,2 kPa").exit_code == 0
    code, out, _ = line("run", folder, "--no-report", "--cores", 1)
    assert code == 1
    assert "failed at young = 1 kPa, seed = 1: step failed" in out
    code, said = subprocess_free("run", folder, "--quiet")
    assert code == 1
    assert said.startswith("2 runs failed, the first of them: step failed")
    answer = call("status", folder)
    assert "2 failed" in answer.output
    assert "failed at young = 2 kPa, seed = 1: step failed" in answer.output
    assert call("report", folder).exit_code == 0


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_ctrl_c_says_how_to_go_on(folder):
    slow = ["--set=duration=30 d", "--set=stop_cells=3000", "--seeds", 2]
    assert call("new", "growth", "-o", folder, *slow).exit_code == 0
    command = [sys.executable, "-m", "multicell", "study", "run", str(folder), "--cores", "1", "-y"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, preexec_fn=listening)
    try:
        deadline = time.monotonic() + 120.0
        while not list(folder.glob("runs/*/frames.journal")):
            assert time.monotonic() < deadline
            assert process.poll() is None
            time.sleep(0.1)
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=120.0)
    finally:
        process.kill()
    assert process.returncode == 130
    assert "the same command continues with what is there" in said
    assert "begun" in call("status", folder).output


def test_options_that_do_not_go_together(folder):
    call("new", "growth", "-o", folder)
    code, said = subprocess_free("run", folder, "--cores", 2, "--scheduler", "tcp://nowhere:1")
    assert code == 2
    assert "--cores has no meaning with --scheduler" in said


def test_without_the_packages_it_is_said_how_to_install_them(folder, monkeypatch):
    call("new", "growth", "-o", folder)
    for package in ("dask", "distributed"):
        monkeypatch.setitem(sys.modules, package, None)
    code, said = subprocess_free("run", folder)
    assert code == 2
    assert 'pip install "multicell[study]"' in said


def _run(name, expected):
    return StudyRun(name, mc.load_scene("growth"), {}, expected)


def test_the_time_left_is_corrected_by_what_was_measured():
    runs = [_run(name, 10.0) for name in "abcd"]
    pace = Pace(runs, 2, 0.0)
    assert pace.remaining(0.0) == 20.0
    assert pace.remaining(5.0) == 15.0
    pace.note(RunOutcome("a", "done", wall=40.0), 40.0)
    # 40 s in place of 10 s, the expectation counting once more: 50/20 of 30 s on two cores
    assert pace.remaining(40.0) == pytest.approx(2.5 * 15.0)
    assert pace.share == 0.25
    pace.note(RunOutcome("b", "done", reused=True), 40.0)
    pace.note(RunOutcome("c", "failed", "lost"), 41.0)
    assert pace.words(41.0)[:2] == ["3 of 4 runs", "1 failed"]
    assert pace.remaining(41.0) == pytest.approx(25.0)
    pace.note(RunOutcome("d", "done", wall=10.0), 60.0)
    assert (pace.share, pace.remaining(99.0)) == (1.0, 0.0)
    assert pace.words(99.0) == ["4 of 4 runs", "1 failed"]
    assert Pace(runs, None, 0.0).remaining(0.0) is None
    assert Pace([], 2, 0.0).share == 1.0


def test_the_longest_run_decides_over_many_cores():
    pace = Pace([_run("a", 100.0), _run("b", 1.0)], 8, 0.0)
    assert pace.remaining(0.0) == 100.0
