"""Studies that are killed, stopped, or have company: nothing is lost, and nothing goes on alone.

``pytest tests/studies/test_engine_kills.py --kills 100`` kills as many processes as asked.
"""

import random
import signal
import time

import psutil
import pytest
from stored import assert_same_bits
from studied import alive, family, gone, is_worker, runs_of, short_runs, started, statuses, wait_for

import multicell as mc
from multicell.studies.engine import run_study

COUNT = 4


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """Each run by itself, in this process."""
    folder = tmp_path_factory.mktemp("undisturbed")
    begin = time.monotonic()
    for run in runs_of(COUNT):
        mc.run(run.scene, output=folder / run.name, report=False, threads=1)
    return folder, time.monotonic() - begin


def summary(folder):
    table = mc.load_result(folder).summary()
    return {name: entry for name, entry in table.items() if name not in ("wall", "peak_memory")}


def assert_complete(folder, whole):
    runs = runs_of(COUNT)
    assert {found.state for found in statuses(runs, folder)} == {"done"}
    for run in runs:
        here, there = folder / "runs" / run.name, whole / run.name
        assert_same_bits(there, here)
        assert summary(there) == summary(here)
        files = {entry.name for entry in here.iterdir()} - {".multicell.lock"}
        assert files == {"scene.toml", "frames.h5", "summary.json"}
    assert {entry.name for entry in (folder / "runs").iterdir()} == {run.name for run in runs}


def ended(process, within=120.0):
    """Wait for the end of a study; return its exit code and what it has said."""
    text, _ = process.communicate(timeout=within)
    return process.returncode, text


def assert_no_tracebacks(text):
    lines = text.splitlines()
    assert [x for x in lines if "Traceback" in x or "distributed" in x or "asyncio" in x] == []


@pytest.mark.slow
def test_killed_studies_go_on_to_the_same_bits(undisturbed, tmp_path, pytestconfig):
    """The process that holds the scheduler, or workers: whatever is killed, at any moment."""
    whole, seconds = undisturbed
    kills = max(3, pytestconfig.getoption("kills"))
    folder, done, case, times = tmp_path / "study0", 0, 0, 0
    process = started(folder, COUNT)
    while done < kills:
        rng = random.Random(case)
        case += 1
        time.sleep(rng.uniform(0.0, 2.0 + seconds / 2.0))
        members = family(process)
        if process.poll() is not None:  # this one is complete: kill the next one
            code, text = ended(process)
            assert code == 0, text
            assert_no_tracebacks(text)
            assert_complete(folder, whole)
            times += 1
            folder = tmp_path / f"study{times}"
            process = started(folder, COUNT)
            continue
        workers = [member for member in members if is_worker(member)]
        if workers and rng.random() < 0.5:
            rng.choice(workers).kill()
            done += 1
            continue
        process.kill()
        done += 1
        assert gone(members), [member.cmdline() for member in members if alive(member)]
        ended(process)
        process = started(folder, COUNT)
    code, text = ended(process)
    assert code == 0, text
    assert_no_tracebacks(text)
    assert_complete(folder, whole)


def under_way(folder, count=1):
    return sum(found.state == "running" for found in statuses(runs_of(COUNT), folder)) >= count


@pytest.mark.slow
def test_ctrl_c_ends_runs_between_two_steps_and_leaves_nobody(undisturbed, tmp_path):
    whole, _ = undisturbed
    process = started(tmp_path, COUNT)
    wait_for(lambda: under_way(tmp_path, 2))
    members = family(process)
    # as a terminal sends it: to all
    for member in [psutil.Process(process.pid), *members]:
        member.send_signal(signal.SIGINT)
    code, text = ended(process)
    assert code == 130
    assert text.splitlines()[-1] == "Interrupted."
    assert_no_tracebacks(text)
    assert gone(members)
    kept = [found for found in statuses(runs_of(COUNT), tmp_path) if found.state == "partial"]
    assert kept
    for found in kept:
        assert mc.load_result(tmp_path / "runs" / found.name).summary()["interrupted"] is True
    code, text = ended(started(tmp_path, COUNT))
    assert code == 0, text
    assert_complete(tmp_path, whole)


@pytest.mark.slow
def test_ctrl_c_at_the_very_beginning(tmp_path):
    for delay in (1.2, 1.6):
        process = started(tmp_path, COUNT)
        time.sleep(delay)
        members = family(process)
        for member in [psutil.Process(process.pid), *members]:
            if alive(member):
                member.send_signal(signal.SIGINT)
        code, text = ended(process)
        assert code in (130, -signal.SIGINT, 1)
        assert "distributed" not in text
        assert gone(members)


@pytest.mark.slow
def test_two_processes_share_a_study_and_both_end_with_all_of_it(undisturbed, tmp_path):
    whole, _ = undisturbed
    both = [started(tmp_path, COUNT) for _ in range(2)]
    answers = [ended(process) for process in both]
    assert [code for code, _ in answers] == [0, 0], answers
    rows = [[line.split() for line in text.splitlines()] for _, text in answers]
    names = {run.name for run in runs_of(COUNT)}
    assert [{row[0] for row in part} for part in rows] == [names, names]
    fresh = [row[0] for part in rows for row in part if row[2] == "False"]
    assert sorted(fresh) == sorted(names)  # each was computed by one of them
    assert_complete(tmp_path, whole)


@pytest.mark.slow
def test_a_run_that_kills_its_worker_again_and_again_is_a_row(tmp_path):
    """A law of the user's own stands for all that ends a process: want of memory, a crash."""
    file = tmp_path / "deadly.py"
    file.write_text(
        "import multiprocessing, os, signal\n"
        "import multicell as mc\n"
        "if multiprocessing.parent_process() is not None:\n"
        "    os.kill(os.getpid(), signal.SIGKILL)\n"
        "@mc.pair_law(parameters={})\n"
        "def deadly(overlap, modulus, radius, p):\n"
        "    return modulus * overlap\n"
    )
    good, other = short_runs(2)
    from dataclasses import replace

    law = mc.load_law(f"{file}:deadly").scene_name()
    scene = other.scene.with_changes({"contact.law": law})
    bad = replace(other, name="0" * 24, scene=scene, expected=60.0)  # a worker does what is long
    outcomes = run_study([bad, good], tmp_path / "study", cores=1)
    assert [outcome.state for outcome in outcomes] == ["failed", "done"]
    assert "its worker process died" in outcomes[0].reason
    assert statuses([bad], tmp_path / "study")[0].reason == outcomes[0].reason
    (again,) = run_study([bad], tmp_path / "study", cores=1)
    assert (again.state, again.reused) == ("failed", True)


@pytest.mark.slow
def test_a_full_disk_is_a_reason_in_a_row_and_loses_nothing(undisturbed, small_disk):
    whole, _ = undisturbed
    size = sum(path.stat().st_size for path in whole.rglob("*") if path.is_file()) // 1024
    mount, _ = small_disk
    folder = mount(size // 2) / "study"
    code, text = ended(started(folder, COUNT))
    assert code == 0, text
    rows = [line.split(maxsplit=3) for line in text.splitlines()]
    assert len(rows) == COUNT
    failed = [row for row in rows if row[1] == "failed"]
    assert failed
    assert [row for row in failed if "No space left on device" not in row[3]] == []
    folder = mount(20 * size) / "study"
    code, text = ended(started(folder, COUNT))
    assert code == 0, text
    assert_complete(folder, whole)
