"""Small studies, in this process or in one that may be killed.

``python studied.py FOLDER COUNT [ADDRESS [DURATION]]`` carries out a study of as many runs and
prints a line for each outcome; exit codes are those of the command ``multicell``.
"""

import os
import subprocess
import sys
import time
from pathlib import Path

import psutil
from signals import listening

import multicell as mc
from multicell.cli.process import exit_code
from multicell.studies import engine
from multicell.studies.engine import Task, do_run, run_study
from multicell.studies.runs import PlainScene, StudyRun, run_digest
from multicell.studies.status import run_status

HERE = Path(__file__)
# cells grow and divide; a field, several frames, half a second of work
CHANGES = {
    "duration": "10 h",
    "initial.count": 60,
    "initial.stage": "uniform",
    "growth.cycle_time": "6 h",
    "output.every": "1 h",
}
# a tenth of a second
SHORT = {"duration": "20 h", "output.every": "4 h"}


def run_of(scene, expected=1.0, **coordinates):
    return StudyRun(run_digest(scene), scene, coordinates, expected)


def runs_of(count, name="spheroid", changes=CHANGES):
    base = mc.load_scene(name).with_changes(changes)
    return [run_of(base.with_changes({"seed": seed}), seed=seed) for seed in range(count)]


def short_runs(count, **changes):
    return runs_of(count, "growth", {**SHORT, **changes})


def statuses(runs, folder):
    return [run_status(run.name, Path(folder)) for run in runs]


def started(folder, count, *more, **options):
    """Start a study in a process of its own, in a session of its own."""
    package = Path(mc.__file__).parents[1]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(package), str(HERE.parent)])}
    command = [sys.executable, str(HERE), str(folder), str(count), *map(str, more)]
    return subprocess.Popen(
        command, env=environment, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        start_new_session=True, preexec_fn=listening, **options,
    )  # fmt: skip


def in_this_process(monkeypatch):
    """Carry runs of studies out in this process, as a worker would; return the names of those."""
    ran = []

    def carried_out(runs, folder, *, progress=None, **options):
        outcomes = []
        for run in runs:
            scene = PlainScene.of(run.scene)
            outcome = do_run(Task(run.name, str(folder), scene, retry=False))
            if not outcome.reused:
                ran.append(run.name)
            outcomes.append(outcome)
            if progress is not None:
                progress(outcome)
        return outcomes

    monkeypatch.setattr(engine, "run_study", carried_out)
    return ran


def family(process):
    """Return all processes that a process has started, directly or not."""
    try:
        return psutil.Process(process.pid).children(recursive=True)
    except psutil.NoSuchProcess:
        return []


def is_worker(process):
    try:
        return "spawn_main" in " ".join(process.cmdline()) and not _is_tracker(process)
    except psutil.Error:
        return False


def _is_tracker(process):
    return "resource_tracker" in " ".join(process.cmdline())


def gone(processes, within=5.0):
    """Return whether processes have ended, now or soon; those that wait for burial count."""
    end = time.monotonic() + within
    while time.monotonic() < end:
        if not any(alive(process) for process in processes):
            return True
        time.sleep(0.05)
    return False


def wait_for(condition, within=60.0):
    end = time.monotonic() + within
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


def alive(process):
    try:
        return process.is_running() and process.status() != psutil.STATUS_ZOMBIE
    except psutil.Error:
        return False


def main(folder, count, scheduler=None, duration=CHANGES["duration"]):
    def said(outcome):
        print(outcome.name, outcome.state, outcome.reused, outcome.reason, flush=True)

    def command():
        run_study(
            runs_of(int(count), changes={**CHANGES, "duration": duration}), folder, cores=2,
            scheduler=scheduler, progress=said,
        )  # fmt: skip

    return exit_code(command, as_json=False)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
