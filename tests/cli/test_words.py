"""Words of commands and errors where something else fails, too."""

import json
import logging
import multiprocessing
import os
import warnings

import numpy as np
import pytest
from click.testing import CliRunner

from multicell.calibration.dose_response.analysis import analyse_doses
from multicell.cli.main import main
from multicell.cli.process import quiet_libraries
from multicell.errors import ClusterError, ExitCode, FitFailed, OutputError
from multicell.studies import engine
from multicell.studies.engine import RunOutcome
from multicell.studies.study import Study
from multicell.studies.workers import workers


def call(*arguments):
    return CliRunner().invoke(main, [str(a) for a in arguments])


@pytest.fixture
def failing(tmp_path, monkeypatch):
    """Return a function that lets runs of a study fail for a kind, and their report, too."""
    folder = tmp_path / "study"
    assert call("study", "new", "growth", "-o", folder, "--seeds", 2).exit_code == 0

    def full(self):
        raise OutputError("cannot write 'study.nc'") from OSError(28, "No space left on device")

    monkeypatch.setattr(Study, "report", full)

    def run(kind, *more):
        def carried_out(runs, *_, **__):
            if not kind:
                return [RunOutcome(run.name, "done") for run in runs]
            return [RunOutcome(run.name, "failed", "step failed: why", kind=kind) for run in runs]

        monkeypatch.setattr(engine, "run_study", carried_out)
        return call("study", "run", folder, "--cores", 1, "--yes", *more)

    return run


@pytest.mark.parametrize(
    ("kind", "code"),
    [("run", ExitCode.FAILED), ("machine", ExitCode.MACHINE), ("unreadable", ExitCode.MACHINE),
     ("damage", ExitCode.FAILED), ("", ExitCode.MACHINE)],
)  # fmt: skip
def test_a_report_that_fails_does_not_hide_how_the_runs_ended(kind, code, failing):
    answer = failing(kind)
    assert answer.exit_code == code
    assert answer.stdout.startswith("2 runs: 0 done, 2 failed" if kind else "2 runs: 2 done")
    assert answer.stdout.count("step failed: why") == (2 if kind else 0)
    assert answer.stderr.splitlines()[-1] == "Error: cannot write 'study.nc'"
    answer = failing(kind, "--json")
    document = json.loads(answer.stdout)
    assert (answer.exit_code, document["failed"]) == (code, 2 if kind else 0)
    assert document["error"] == "cannot write 'study.nc'"


def test_a_control_whose_runs_failed_is_said_to_have_none():
    values = np.array([[np.nan, np.nan], *([[1.0, 0.9]] * 4)])
    rows = [{"reason": "no memory", "run": str(k)} for k in range(10)]
    points = np.arange(5.0)[:, None]
    with pytest.raises(FitFailed, match=r"nothing is known of the control: its runs failed.*no me"):
        analyse_doses(points, values, rows, names=("drug",), units=("uM",), response="living cells",
                shared=True, title="x")  # fmt: skip


def _study_in_a_pool(_):
    try:
        with workers(2, None):
            return "started"
    except ClusterError as error:
        return str(error)


@pytest.mark.slow
def test_a_worker_of_a_pool_is_told_that_it_may_start_no_others():
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        (said,) = pool.map(_study_in_a_pool, [0])
    assert "this process is a worker of a pool" in said
    assert "cores=1" in said
    assert "memory" not in said


def test_quiet_is_quiet_of_libraries_and_only_as_long_as_it_lasts(capfd, monkeypatch):
    monkeypatch.delenv("PYTHONWARNINGS", raising=False)
    before = logging.root.manager.disable

    def loud(*_, **__):
        warnings.warn("of a library", UserWarning, stacklevel=1)
        logging.getLogger("matplotlib.font_manager").warning("findfont: not found")
        assert os.environ.get("PYTHONWARNINGS") == "ignore"

    with quiet_libraries():
        loud()
    assert capfd.readouterr().err == ""
    assert (logging.root.manager.disable, os.environ.get("PYTHONWARNINGS")) == (before, None)
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        warnings.warn("again", UserWarning, stacklevel=1)
    assert len(seen) == 1
    monkeypatch.setattr("multicell.runner.run", loud)
    answer = call("run", "growth", "-o", "x", "--quiet")
    assert "of a library" not in answer.stderr
