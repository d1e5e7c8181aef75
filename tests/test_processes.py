"""Runs beside others: in forked processes, in several threads, with files that others hold."""

import errno
import os
import shutil
import signal
import subprocess
import sys
import threading

import h5py
import numpy as np
import pytest

import multicell as mc
from multicell.compiling import threads as compiling_threads
from multicell.compiling.threads import Team
from multicell.results import hdf5
from multicell.results.hdf5 import File

RUNS = """
import hashlib, multiprocessing, sys, threading
import multicell as mc
from multicell.mechanics.system import Mechanics

usual, shared = Mechanics.shared, []
Mechanics.shared = lambda *given: shared.append(usual(*given)) or shared[-1]

def made():
    # small chunks give threads something to share among few cells
    scene = mc.load_scene("growth").with_changes({"initial.count": 600, "duration": "20 min"})
    simulation = mc.Simulation(scene, threads=2)
    simulation.mechanics.chunk, simulation.mechanics.shared_chunks = 32, 2
    return simulation

def run(simulation=None):
    simulation = simulation or made()
    while not simulation.finished:
        simulation.step()
    return hashlib.sha1(simulation.cells.position.tobytes()).hexdigest()

def in_child(queue, simulation):
    queue.put(run(simulation))
"""
FORKS = """
begun = made()
begun.step()
expected = run()
assert any(shared)
fork = multiprocessing.get_context("fork")
for simulation in (None, begun):
    queue = fork.Queue()
    child = fork.Process(target=in_child, args=(queue, simulation), daemon=True)
    child.start()
    print(queue.get(timeout=100.0) == expected)
    child.join()
print(run() == expected)
"""
THREADS = """
expected, found = run(), []
assert any(shared)
for _ in range(2):
    threads = [threading.Thread(target=lambda: found.append(run())) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
print(found == 4 * [expected])
"""


def _printed(program, **environment):
    done = subprocess.run(
        [sys.executable, "-c", RUNS + program], capture_output=True, text=True, timeout=300,
        env={**os.environ, "NUMBA_NUM_THREADS": "2", **environment}, check=False,
    )  # fmt: skip
    assert done.returncode == 0, (done.returncode, done.stderr[-1000:])
    return done.stdout.split()


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system does not fork")
@pytest.mark.parametrize("layer", ["default", "workqueue"])
def test_a_process_forked_after_a_run_of_threads_comes_to_the_same_bits(layer):
    assert _printed(FORKS, NUMBA_THREADING_LAYER=layer) == ["True"] * 3


@pytest.mark.slow
@pytest.mark.parametrize("layer", ["default", "workqueue"])
def test_two_runs_in_two_threads_come_to_the_same_bits(layer):
    assert _printed(THREADS, NUMBA_THREADING_LAYER=layer) == ["True"]


def _met(team):
    """Return the threads that share a loop of a team, each of which waits for all others."""
    barrier, found = threading.Barrier(team.threads, timeout=60.0), set()

    def meet(begin, end):
        assert end == begin + 1
        found.add(threading.current_thread())
        barrier.wait()

    team.share(meet, team.threads)
    assert len(found) == team.threads
    return found - {threading.current_thread()}


@pytest.fixture
def none_resting(monkeypatch):
    monkeypatch.setattr(compiling_threads, "_RESTING", {})


@pytest.mark.usefixtures("none_resting")
def test_teams_of_any_sizes_leave_the_threads_of_the_largest():
    met = set()
    for number in (*range(2, 10), *range(9, 1, -1)):
        with Team(number) as team:
            met |= _met(team)
    alive = {thread for thread in met if thread.is_alive()}
    assert len(alive) == 8
    with Team(5) as team:
        assert _met(team) <= alive


@pytest.mark.usefixtures("none_resting")
@pytest.mark.parametrize("sizes", [(4, 3), (3, 4), (3, 3)])
def test_a_team_within_another_has_threads_of_its_own_of_which_the_most_are_kept(sizes):
    for _ in range(2):
        with Team(sizes[0]) as outer:
            mine = _met(outer)
            with Team(sizes[1]) as inner:
                others = _met(inner)
                assert not mine & others
                assert not _met(outer) & _met(inner)
    ((most, executor),) = compiling_threads._RESTING.values()
    assert most == max(sizes)
    assert {thread for thread in mine | others if thread.is_alive()} <= executor._threads


@pytest.mark.usefixtures("none_resting")
def test_teams_in_many_threads_at_once_never_share_and_leave_those_of_one():
    met, held, shared, rounds = set(), set(), [], 20
    lock = threading.Lock()

    def work(seed):
        for number in np.random.default_rng(seed).integers(2, 5, rounds):
            with Team(int(number)) as team:
                mine = _met(team)
                with lock:
                    shared.append(bool(mine & held))
                    held.update(mine)
                    met.update(mine)
                _met(team)
                with lock:
                    held.difference_update(mine)

    workers = [threading.Thread(target=work, args=(seed,)) for seed in range(4)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    assert shared == [False] * (4 * rounds)
    resting = compiling_threads._RESTING
    assert list(resting) == [os.getpid()]
    for thread in met - set(resting[os.getpid()][1]._threads):
        thread.join(timeout=60.0)  # those without a team that nobody stopped end by themselves
    assert sum(thread.is_alive() for thread in met) <= 3


@pytest.mark.usefixtures("none_resting")
def test_an_error_ends_the_threads_of_its_team():
    met = set()

    def fail():
        with Team(3) as team:
            met.update(_met(team))
            team.share(lambda begin, end: 1 // begin, 3)

    with pytest.raises(ZeroDivisionError):
        fail()
    assert len(met) == 2
    assert not any(thread.is_alive() for thread in met)
    with Team(3) as team:
        assert not _met(team) & met


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system does not fork")
@pytest.mark.usefixtures("none_resting")
@pytest.mark.parametrize("within", [True, False])
def test_a_process_forked_within_a_team_or_after_it_has_teams_of_its_own(within):
    parent = os.getpid()

    def forked():
        child = os.fork()
        if child == 0:  # ends if it hangs
            signal.signal(signal.SIGALRM, signal.SIG_DFL)
            signal.alarm(30)
        return child

    try:
        with Team(3) as team:
            met = _met(team)
            child = forked() if within else None
        child = forked() if child is None else child
        if child == 0:
            for number in (3, 2, 4):
                with Team(number) as own:
                    assert not _met(own) & met
            os._exit(0)
    finally:
        if os.getpid() != parent:
            os._exit(1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    with Team(3) as team:
        assert _met(team) == met


HOLDS = """
import sys, time, h5py
file = h5py.File(sys.argv[1], "r+")
exec(sys.argv[2])
file.flush()
print("open", flush=True)
time.sleep(600)
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("held") / "out"
    scene = mc.load_scene("growth").with_changes({"initial.count": 20, "duration": "1 h"})
    mc.run(scene, output=place, report=False, threads=1)
    return place


@pytest.fixture
def held(folder, tmp_path):
    """Return a copy of the folder, and what lets another program open its file."""
    place, holders = tmp_path / "out", []
    shutil.copytree(folder, place)

    def hold(change="pass"):
        holder = subprocess.Popen(
            [sys.executable, "-c", HOLDS, str(place / "frames.h5"), change], stdout=subprocess.PIPE
        )
        assert holder.stdout.readline() == b"open\n"
        holders.append(holder)
        return holder

    yield place, hold
    for holder in holders:
        holder.kill()
        holder.wait()
        holder.stdout.close()


def _positions(place):
    return [frame.cells.position for frame in mc.load_result(place).frames]


def test_a_file_that_another_program_has_open_is_read(held, folder):
    place, hold = held
    holder = hold()
    np.testing.assert_equal(_positions(place), _positions(folder))
    holder.kill()  # what HDF5 writes at its beginning stays
    holder.wait()
    with pytest.raises(OSError, match="already open for write"):
        h5py.File(place / "frames.h5", locking=False)
    np.testing.assert_equal(_positions(place), _positions(folder))
    assert mc.resume(place, changes={"duration": "2 h"}, report=False, threads=1).frames[-1].time


def test_a_file_that_another_program_changes_is_held_and_then_damaged(held):
    place, hold = held
    holder = hold("file['cells/radius'][0] += 1.0")
    frames = mc.load_result(place).frames
    with pytest.raises(mc.OutputError, match="open for writing in another program") as found:
        frames[0]
    assert not found.value.damaged
    assert "is damaged" not in str(found.value)
    holder.kill()
    holder.wait()
    with pytest.raises(mc.OutputError, match="is damaged") as found:
        mc.load_result(place).frames[0]
    assert found.value.damaged


def test_a_file_that_is_cut_or_marked_in_its_first_bytes_is_damaged(folder, tmp_path):
    whole, path = (folder / "frames.h5").read_bytes(), tmp_path / "frames.h5"
    marked = whole[:11] + b"\1" + whole[12:]
    for data in [whole[:n] for n in range(60)] + [marked[:n] for n in range(60)]:
        path.write_bytes(data)
        with pytest.raises(mc.OutputError, match="damaged") as found:
            File(path)
        assert found.value.damaged
    for place in (9, 13, 20, 30, 40, 45):  # beside the mark something else is wrong
        path.write_bytes(marked[:place] + bytes([marked[place] ^ 4]) + marked[place + 1 :])
        with pytest.raises(mc.OutputError, match="damaged"):
            File(path)
    path.write_bytes(marked)
    File(path).check()


@pytest.mark.parametrize("number", [errno.EMFILE, errno.EACCES, errno.EIO, errno.ESTALE])
def test_what_the_machine_refuses_is_not_called_damage(number, folder, monkeypatch):
    monkeypatch.setattr(hdf5, "_FRAMES", {})  # those that this process has just written are kept
    result = mc.load_result(folder)

    def refused(*arguments, **options):
        raise OSError(number, f"Unable to synchronously open file (errno = {number})")

    monkeypatch.setattr(hdf5.h5py, "File", refused)
    with pytest.raises(mc.OutputError, match=os.strerror(number)) as found:
        result.frames[0]
    assert not found.value.damaged
    assert "damaged" not in str(found.value)
    with pytest.raises(mc.OutputError, match=os.strerror(number)) as found:
        File(folder / "frames.h5")
    assert not found.value.damaged


def test_too_many_open_files_are_said(folder):
    program = """
import resource, sys
import multicell as mc
mc.load_result(sys.argv[1]).frames[0]
taken = []
resource.setrlimit(resource.RLIMIT_NOFILE, (64, 64))
try:
    while True:
        taken.append(open("/dev/null"))
except OSError:
    pass
try:
    mc.load_result(sys.argv[1])
except mc.OutputError as error:
    print(error.damaged, str(error))
"""
    done = subprocess.run(
        [sys.executable, "-c", program, str(folder)], capture_output=True, text=True, check=True
    )
    assert done.stdout.startswith("False cannot read")
    assert done.stdout.rstrip().endswith(os.strerror(errno.EMFILE))
