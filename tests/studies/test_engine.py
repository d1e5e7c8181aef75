"""Studies are carried out completely, once, and named where they cannot be."""

import json
import logging
import os
import subprocess
import sys
import threading
from contextlib import nullcontext
from pathlib import Path

import pytest
from stored import assert_same_bits
from studied import run_of, runs_of, short_runs, statuses

import multicell as mc
from multicell.errors import ClusterError, SceneError
from multicell.results.documents import write_table
from multicell.results.folder import lock_folder
from multicell.studies import engine
from multicell.studies.engine import do_run, run_study
from multicell.studies.status import NOTE
from multicell.studies.workers import workers

PLACES = [str(Path(__file__).parents[1] / "helpers"), str(Path(mc.__file__).parents[1])]


def states(runs, folder):
    return [found.state for found in statuses(runs, folder)]


def in_this_process(monkeypatch, *troubles):
    """Do without Dask: what is tested is no matter of it.

    ``troubles`` come in place of answers, first: strings are states of futures, errors those of
    tasks, and types of errors what happens to answers on their way.
    """
    troubles = list(troubles)

    class Future:
        def __init__(self, answer):
            self.key, self.answer = str(id(self)), answer
            self.trouble = troubles.pop(0) if troubles else None
            self.status = "error" if isinstance(self.trouble, Exception) else "finished"
            if isinstance(self.trouble, str):
                self.status = self.trouble

        def exception(self):
            return self.trouble

        def result(self, timeout=None):
            if self.trouble is not None:
                raise self.trouble
            return self.answer

        def add_done_callback(self, call):
            call(self)

    class Client:
        status, cluster = "running", None

        def nthreads(self):
            return {"here": 1}

        def submit(self, function, versions, task, work, **_):
            return Future(do_run(work))

    monkeypatch.setattr(engine, "workers", lambda *_: nullcontext(Client()))


@pytest.mark.slow
def test_a_study_is_done_once_and_each_run_is_what_it_would_be_alone(tmp_path):
    runs = short_runs(5)
    told = []
    outcomes = run_study([*runs, runs[0]], tmp_path / "study", cores=2, progress=told.append)
    assert [o.name for o in outcomes] == [run.name for run in [*runs, runs[0]]]
    assert {(o.state, o.reused) for o in outcomes} == {("done", False)}
    assert sorted(o.name for o in told) == sorted(run.name for run in runs)
    assert min(o.wall for o in outcomes) > 0.0
    for run in runs[:2]:
        mc.run(run.scene, output=tmp_path / run.name, report=False, threads=1)
        assert_same_bits(tmp_path / run.name, tmp_path / "study" / "runs" / run.name)
    found = statuses(runs, tmp_path / "study")
    assert {s.state for s in found} == {"done"}
    assert {s.time for s in found} == {72000.0}
    assert min(s.cells for s in found) > 1
    assert min(s.wall for s in found) > 0.0


@pytest.mark.slow
def test_short_runs_on_one_core_and_what_is_done_need_no_dask(tmp_path):
    stamps = []
    for reused in (False, True):
        code = (
            f"import sys; sys.path[:0] = {PLACES!r}; from studied import short_runs"
            "; from multicell.studies.engine import run_study"
            f"; done = run_study(short_runs(2), {str(tmp_path)!r}, cores={None if reused else 1})"
            f"; assert [(o.state, o.reused) for o in done] == [('done', {reused})] * 2"
            "; assert not {'dask', 'distributed'} & set(sys.modules)"
        )
        subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
        stamps.append({path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")})
    assert stamps[0] == stamps[1]


def test_the_longest_come_first(tmp_path, monkeypatch):
    in_this_process(monkeypatch)
    expected = [1.0, 3.0, 2.0]
    runs = [run_of(run.scene, e) for run, e in zip(short_runs(3), expected, strict=True)]
    told = []
    run_study(runs, tmp_path, progress=lambda outcome: told.append(outcome.name))
    assert told == [runs[1].name, runs[2].name, runs[0].name]


@pytest.mark.slow
def test_half_done_runs_go_on_with_the_same_bits(tmp_path, monkeypatch):
    """Also where an interruption has added a frame that the scene does not ask for."""
    in_this_process(monkeypatch)
    (run,) = runs_of(1)
    place = tmp_path / "runs" / run.name

    def stop(simulation):
        if simulation.step_index == 20:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        mc.run(run.scene, output=place, report=False, threads=1, progress=stop)
    assert json.loads((place / "summary.json").read_text())["interrupted"] is True
    (found,) = statuses([run], tmp_path)
    assert (found.state, found.time) == ("partial", 12000.0)
    assert found.cells >= 60
    (outcome,) = run_study([run], tmp_path)
    assert (outcome.state, outcome.reused) == ("done", False)
    mc.run(run.scene, output=tmp_path / "whole", report=False, threads=1)
    assert_same_bits(tmp_path / "whole", place)
    one, other = (mc.load_result(f).summary() for f in (place, tmp_path / "whole"))
    for summary in (one, other):
        del summary["wall"], summary["peak_memory"]
    assert one == other


FAILS = {"integrator.method": "cvode", "integrator.max_steps": 1}


def test_a_run_that_fails_is_a_row_with_its_reason(tmp_path, monkeypatch):
    in_this_process(monkeypatch)
    good, bad = short_runs(1)[0], short_runs(1, **FAILS)[0]
    outcomes = run_study([good, bad], tmp_path)
    assert [o.state for o in outcomes] == ["done", "failed"]
    assert outcomes[1].reason.startswith("step failed")
    found = statuses([good, bad], tmp_path)[1]
    assert (found.state, found.reason, found.kind) == ("failed", outcomes[1].reason, "run")
    again = run_study([good, bad], tmp_path)
    assert [(o.state, o.reused) for o in again] == [("done", True), ("failed", True)]
    asked = run_study([good, bad], tmp_path, retry=True)
    assert [(o.state, o.reused) for o in asked] == [("done", True), ("failed", False)]
    assert asked[1].reason == outcomes[1].reason


def test_what_the_machine_refused_is_tried_again_unasked(tmp_path, monkeypatch):
    in_this_process(monkeypatch)
    (run,) = short_runs(1)
    place = tmp_path / "runs" / run.name
    place.mkdir(parents=True)
    reason = "cannot write: No space left on device"
    write_table(place / NOTE, {"reason": reason, "kind": "machine"})
    (found,) = statuses([run], tmp_path)
    assert (found.state, found.reason) == ("failed", reason)
    (outcome,) = run_study([run], tmp_path)
    assert (outcome.state, outcome.reused) == ("done", False)
    assert not (place / NOTE).exists()


DAMAGES = {
    "summary": ("summary.json", lambda data: data[:50]),
    "file cut short": ("frames.h5", lambda data: data[: len(data) // 2]),
    "another scene": ("scene.toml", lambda data: data.replace(b"seed = 0", b"seed = 7")),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_what_is_damaged_is_named_and_computed_anew_where_asked_for(damage, tmp_path, monkeypatch):
    in_this_process(monkeypatch)
    (run,) = short_runs(1)
    place = tmp_path / "runs" / run.name
    run_study([run], tmp_path)
    name, change = DAMAGES[damage]
    path = place / name
    damaged = change(path.read_bytes())
    path.write_bytes(damaged)
    (found,) = statuses([run], tmp_path)
    assert (found.state, found.kind) == ("failed", "damage")
    assert found.reason.startswith("damaged: ")
    (outcome,) = run_study([run], tmp_path)
    assert (outcome.state, outcome.reason, outcome.reused) == ("failed", found.reason, True)
    (outcome,) = run_study([run], tmp_path, retry=True)
    assert (outcome.state, outcome.reused) == ("done", False)
    mc.run(run.scene, output=tmp_path / "whole", report=False, threads=1)
    assert_same_bits(tmp_path / "whole", place)
    aside = place.with_name(f"{place.name}.damaged-1")
    assert (aside / name).read_bytes() == damaged
    assert {entry.name for entry in aside.iterdir()} == {entry.name for entry in place.iterdir()}


def test_a_damaged_frame_of_a_half_done_run_is_named(tmp_path, monkeypatch):
    in_this_process(monkeypatch)
    (run,) = runs_of(1)
    place = tmp_path / "runs" / run.name

    def killed(simulation):
        if simulation.step_index == 20:
            raise SystemExit

    monkeypatch.setattr("multicell.runner.Recorder.finish", lambda *_, **__: None)
    with pytest.raises(SystemExit):
        mc.run(run.scene, output=place, report=False, threads=1, progress=killed)
    monkeypatch.undo()
    in_this_process(monkeypatch)
    path = place / "frames.journal"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(bytes(data))
    (outcome,) = run_study([run], tmp_path)
    assert outcome.state == "failed"
    assert outcome.reason.startswith("damaged: ")
    assert states([run], tmp_path) == ["failed"]
    (outcome,) = run_study([run], tmp_path, retry=True)
    assert outcome.state == "done"


def test_what_another_process_does_is_left_to_it_and_waited_for(tmp_path, monkeypatch):
    in_this_process(monkeypatch)
    runs = short_runs(2)
    place = tmp_path / "runs" / runs[0].name
    place.mkdir(parents=True)
    told, ready, over = [], threading.Event(), threading.Event()

    def other():
        with lock_folder(place):
            ready.set()
            over.wait(60)

    holder = threading.Thread(target=other)
    holder.start()
    ready.wait(60)
    assert states(runs, tmp_path) == ["running", "waiting"]
    threading.Timer(1.5, over.set).start()
    outcomes = run_study(runs, tmp_path, progress=told.append)
    holder.join()
    # the other one has let go without a result, so it is done here
    assert [(o.state, o.reused) for o in outcomes] == [("done", False)] * 2
    assert [o.name for o in told] == [runs[1].name, runs[0].name]


def test_what_is_left_of_a_run_without_frames_is_begun_anew(tmp_path, monkeypatch):
    in_this_process(monkeypatch)
    (run,) = short_runs(1)
    place = tmp_path / "runs" / run.name
    place.mkdir(parents=True)
    (place / "scene.toml.part").write_text("half")
    (place / "scene.toml").write_text("title =")
    (place / "frames.journal.part").write_bytes(b"mcj")
    assert states([run], tmp_path) == ["waiting"]
    (outcome,) = run_study([run], tmp_path)
    assert (outcome.state, outcome.reused) == ("done", False)


def test_files_that_are_not_ours_are_never_removed(tmp_path, monkeypatch):
    in_this_process(monkeypatch)
    (run,) = short_runs(1)
    place = tmp_path / "runs" / run.name
    place.mkdir(parents=True)
    (place / "notes.txt").write_text("mine")
    (outcome,) = run_study([run], tmp_path)
    assert outcome.state == "failed"
    assert "notes.txt" in outcome.reason
    assert (place / "notes.txt").read_text() == "mine"


@pytest.mark.slow
def test_workers_leave_this_process_as_it_was():
    main, before = sys.modules["__main__"], dict(os.environ)
    names = {name: vars(main).get(name) for name in ("__file__", "__spec__")}
    import distributed  # noqa: F401 - it sets up its loggers

    loggers = [logging.getLogger(name) for name in ("distributed", "distributed.client", "asyncio")]
    levels = [logger.level for logger in loggers]
    with workers(1, None) as client:
        assert list(client.nthreads().values()) == [1]
        (loaded,) = client.run(eval, "'multicell.runner' in __import__('sys').modules").values()
        assert loaded is True
        assert client.run(os.getenv, "OMP_NUM_THREADS").popitem()[1] == "1"
    assert dict(os.environ) == before
    assert {name: vars(main).get(name) for name in names} == names
    assert [logger.level for logger in loggers] == levels


@pytest.mark.slow
def test_a_script_needs_no_guard(tmp_path):
    """Processes that start afresh would run the script again that has started them."""
    script = tmp_path / "script.py"
    script.write_text(
        f"import sys; sys.path[:0] = {PLACES!r}\n"
        "print('script', flush=True)\n"
        "from multicell.studies.engine import run_study\n"
        "from studied import short_runs\n"
        f"outcomes = run_study(short_runs(2), {str(tmp_path / 'study')!r}, cores=2)\n"
        "print([outcome.state for outcome in outcomes], __file__)\n"
    )
    command = [sys.executable, str(script)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == ["script", f"['done', 'done'] {script}"]


def test_a_worker_that_cannot_begin_a_run_is_a_reason_that_does_not_last(tmp_path, monkeypatch):
    in_this_process(monkeypatch, ModuleNotFoundError("No module named 'multicell'"))
    runs = short_runs(2)
    outcomes = run_study(runs, tmp_path)
    first = next(outcome for outcome in outcomes if outcome.state == "failed")
    assert first.reason == (
        "its worker could not begin it: ModuleNotFoundError: No module named 'multicell'"
    )
    assert sorted(outcome.state for outcome in run_study(runs, tmp_path)) == ["done", "done"]


def test_an_answer_that_is_lost_is_found_in_the_folder(tmp_path, monkeypatch):
    in_this_process(monkeypatch, TimeoutError)
    outcomes = run_study(short_runs(2), tmp_path)
    assert [(o.state, o.reused) for o in outcomes] == [("done", True), ("done", False)]


def test_a_scheduler_that_goes_is_an_error_that_keeps_all(tmp_path, monkeypatch):
    in_this_process(monkeypatch, "cancelled")
    with pytest.raises(ClusterError, match="the scheduler has gone") as caught:
        run_study(short_runs(2), tmp_path)
    assert caught.value.exit_code == 3
    in_this_process(monkeypatch)
    assert {outcome.state for outcome in run_study(short_runs(2), tmp_path)} == {"done"}


def test_cores_must_be_some(tmp_path):
    with pytest.raises(SceneError, match="cores: is 0"):
        run_study(short_runs(1), tmp_path, cores=0)


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "nowhere"])
def test_a_scheduler_that_does_not_answer_is_named_before_anything_runs(address, tmp_path, capfd):
    with pytest.raises(ClusterError, match=f"the scheduler '{address}' does not answer") as caught:
        run_study(short_runs(1), tmp_path, scheduler=address)
    assert caught.value.exit_code == 2
    assert not any((tmp_path / "runs").iterdir())
    assert capfd.readouterr() == ("", "")
