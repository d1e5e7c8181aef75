"""Ctrl-C and other signals at any moment: no crash, no traceback, nothing lost.

``pytest -m harness tests/test_interrupts.py --interrupts 200`` tries as many as asked, from the
case ``--first-seed`` on.
"""

import contextlib
import json
import os
import random
import re
import signal
import subprocess
import sys
import threading
import time
import traceback

import numpy as np
import pytest
from forks import Patience
from signals import listening
from stored import assert_same_bits

import multicell as mc
from multicell.host import interrupts
from multicell.host.interrupts import UNCUT, WHOLE_STEP
from multicell.integrators.restarts import IntegrationProgress
from multicell.results import folder
from multicell.results.documents import Lines, read_document
from multicell.results.hdf5 import check_readable
from multicell.results.reader import Contents
from multicell.results.writer import Store
from multicell.simulation import Simulation

SCENE = mc.load_scene("growth").with_changes({"initial.count": 60, "duration": "9 d"})


@pytest.fixture
def handled():
    """Let a test change handlers, and put back those of before."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGALRM)}
    # a process that a shell starts in the background does not hear Ctrl-C
    signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    for number, handler in before.items():
        signal.signal(number, handler)


OTHERS = ("rkc2", "euler", "cvode", "rosenbrock")
"""Methods that compile a loop of their own each."""


@pytest.mark.parametrize(
    "method",
    ["auto", *(pytest.param(m, marks=pytest.mark.slow) for m in OTHERS)],
)
def test_no_kernel_calls_python(method):
    """Results of kernels are made without Python, where a signal's handler could raise."""
    scene, called = SCENE.with_changes({"integrator.method": method}), set()
    before = Simulation(scene, threads=1)
    for _ in range(2):  # what a step of these two needs is compiled then
        before.step()
    simulation = Simulation(scene, threads=1)
    simulation.step()

    def note(frame, event, argument):
        if event == "call":
            called.add(frame.f_code.co_filename)

    sys.setprofile(note)
    try:
        simulation.step()
    finally:
        sys.setprofile(None)
    assert any(path.endswith("simulation.py") for path in called)
    assert [path for path in called if "numba" in path.split(os.sep)] == []


class LateError(Exception):
    pass


@pytest.mark.parametrize("method", ["auto", "cvode"])
@pytest.mark.slow
def test_handlers_that_raise_at_any_moment_leave_a_whole_state(method, handled):
    simulation = Simulation(SCENE.with_changes({"integrator.method": method}), threads=1)
    simulation.step()
    rng, raised = random.Random(1), 0

    def late(number, frame):
        # what replaces handlers cannot itself be cut: there the next moment is taken, unless it is
        # who calls this
        stack = [one.f_code.co_filename for one, _ in traceback.walk_stack(frame)]
        if frame is not None and interrupts.__file__ in stack:
            signal.setitimer(signal.ITIMER_REAL, 1e-4)
            return
        raise LateError

    signal.signal(signal.SIGALRM, late)
    end = time.monotonic() + 1.5
    while time.monotonic() < end:
        try:
            signal.setitimer(signal.ITIMER_REAL, rng.uniform(2e-4, 2e-2))
            for _ in range(30):
                simulation.step()
            signal.setitimer(signal.ITIMER_REAL, 0.0)
        except LateError:
            raised += 1
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    assert raised > 20
    undisturbed = Simulation(SCENE.with_changes({"integrator.method": method}), threads=1)
    for _ in range(simulation.step_index):
        undisturbed.step()
    np.testing.assert_array_equal(simulation.cells.position, undisturbed.cells.position)
    np.testing.assert_array_equal(simulation.cells.id, undisturbed.cells.id)


def test_ctrl_c_comes_at_the_end_of_a_step(handled, monkeypatch):
    simulation = Simulation(SCENE, threads=1)
    advance = Simulation._advance

    def pressed(self):
        os.kill(os.getpid(), signal.SIGINT)
        advance(self)

    monkeypatch.setattr(Simulation, "_advance", pressed)
    with pytest.raises(KeyboardInterrupt):
        simulation.step()
    assert simulation.step_index == 1
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_second_ctrl_c_leaves_the_state_of_the_beginning(handled, monkeypatch):
    simulation = Simulation(SCENE, threads=1)
    advance = Simulation._advance

    def pressed(self):
        advance(self)
        os.kill(os.getpid(), signal.SIGINT)
        os.kill(os.getpid(), signal.SIGINT)
        os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(Simulation, "_advance", pressed)
    with pytest.raises(KeyboardInterrupt):
        simulation.step()
    assert simulation.step_index == 0
    assert simulation.time == 0.0


def test_a_handler_of_the_users_own_is_called_once_at_the_end(handled):
    seen = []
    signal.signal(signal.SIGINT, lambda number, frame: seen.append(number))
    with WHOLE_STEP:
        os.kill(os.getpid(), signal.SIGINT)
        assert seen == []
    assert seen == [signal.SIGINT]


@pytest.mark.parametrize("inner", [False, True])
def test_no_signal_cuts_a_compilation(inner, handled):
    seen = []

    def late(number, frame):
        seen.append(number)
        raise LateError

    signal.signal(signal.SIGALRM, late)

    def compiled():
        with WHOLE_STEP, UNCUT:
            for number in (signal.SIGINT, signal.SIGINT, signal.SIGALRM)[: 3 if inner else 2]:
                os.kill(os.getpid(), number)
            seen.append("whole")

    with pytest.raises((KeyboardInterrupt, LateError)):
        compiled()
    assert seen == ["whole", signal.SIGALRM][: 1 + inner]
    assert signal.getsignal(signal.SIGALRM) is late


def test_other_threads_leave_handlers_alone(handled):
    before = signal.getsignal(signal.SIGINT)
    found = []

    def block():
        with WHOLE_STEP, UNCUT:
            found.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=block)
    thread.start()
    thread.join()
    assert found == [before]


# what is written, and what libraries call back

WRITES = """
import os, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
import multicell as mc
from multicell.results import folder, hdf5
from multicell.results.reader import Contents

scene = mc.load_scene("growth").with_changes(
    {"initial.count": 20, "duration": "2 h", "output.every": "20 min"})
whole = mc.run(scene, output="whole", report=False, threads=1)
count = len(whole.frames)

def pressing(owner, name, call, presses):
    inner, calls = getattr(owner, name), [0]
    def pressed(*arguments, **options):
        calls[0] += 1
        if calls[0] == call:
            for _ in range(presses):
                os.kill(os.getpid(), signal.SIGINT)
        return inner(*arguments, **options)
    setattr(owner, name, pressed)
    return lambda: setattr(owner, name, inner)

MOMENTS = [(hdf5.Sink, "write", k) for k in (1, 2, 20, 60)] + [
    (hdf5.Sink, "flush", 1), (hdf5.Sink, "truncate", 1), (hdf5.Sink, "finish", 1),
    (hdf5, "frame_rows", 3), (hdf5.File, "_all", 1), (folder, "put_in_place", 2)]
for number, (owner, name, call) in enumerate(MOMENTS):
    for presses in (1, 2, 3):
        out = f"out-{number}-{presses}"
        mc.run(scene.with_changes({"duration": "1 h"}), output=out, report=False, threads=1)
        undo = pressing(owner, name, call, presses)
        try:
            mc.resume(out, changes={"duration": "2 h"}, report=False, threads=1)
        except KeyboardInterrupt:
            pass
        else:
            sys.exit(f"nothing was raised: {name} {call} {presses}")
        finally:
            undo()
        found = Contents(out)
        assert found.file is not None, out
        for k, place in enumerate(found.places):
            found.frame(k)
        assert len(found.places) >= count, out
        again = mc.load_result(out)
        assert again.frames[-1].time == 7200.0, (name, call, presses)
        found.history()
        assert not [name for name in os.listdir(out) if name.endswith(".part")]
        assert os.path.exists(f"{out}/summary.json"), (name, call, presses)
print("whole")
"""


@pytest.mark.slow
def test_no_press_cuts_a_file_that_is_written(tmp_path):
    done = subprocess.run(
        [sys.executable, "-X", "faulthandler", "-c", WRITES], capture_output=True, text=True,
        cwd=tmp_path, timeout=300, preexec_fn=listening, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (0, "whole\n"), done.stderr[-2000:]


@pytest.mark.parametrize("how", ["flipped", "cut", "another"])
def test_what_does_not_read_back_takes_the_place_of_nothing(how, tmp_path, monkeypatch):
    scene = SCENE.with_changes({"initial.count": 20, "duration": "1 h"})
    mc.run(scene, output=tmp_path / "out", report=False, threads=1)
    before = (tmp_path / "out" / "frames.h5").read_bytes()
    sync = folder.sync_file

    def hurt(path):
        data = bytearray(path.read_bytes())
        if path.name == "frames.h5.part":
            data[len(data) // 2] ^= 1
            new = {"flipped": data, "cut": data[:-100], "another": before}[how]
            path.write_bytes(new)
        sync(path)

    monkeypatch.setattr(folder, "sync_file", hurt)
    with pytest.raises(mc.OutputError, match="kept in frames"):
        mc.resume(tmp_path / "out", changes={"duration": "2 h"}, report=False, threads=1)
    assert (tmp_path / "out" / "frames.h5").read_bytes() == before
    assert mc.load_result(tmp_path / "out").frames[-1].time == 7200.0
    monkeypatch.undo()
    result = mc.resume(tmp_path / "out", report=False, threads=1)
    assert result.frames[-1].time == 7200.0
    assert not (tmp_path / "out" / "frames.journal").exists()


@pytest.mark.parametrize("presses", [1, 2, 3])
@pytest.mark.parametrize("method", ["cvode", "scipy-bdf", "scipy-lsoda"])
def test_a_second_press_ends_a_solve_at_its_next_evaluation(method, presses, handled, monkeypatch):
    simulation = Simulation(SCENE.with_changes({"integrator.method": method}), threads=1)
    simulation.step()
    inner, calls = IntegrationProgress.velocity, []

    def pressed(self, *arguments):
        inner(self, *arguments)
        calls.append(len(calls))
        if len(calls) == 4:
            for _ in range(presses):
                os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(IntegrationProgress, "velocity", pressed)
    with pytest.raises(KeyboardInterrupt) as found:
        simulation.step()
    if presses == 1:
        assert len(calls) > 5
        assert simulation.step_index == 2
        return
    assert len(calls) == 4
    assert simulation.step_index == 1
    assert "_deliver" in [entry.name for entry in found.traceback]
    monkeypatch.undo()
    simulation.step()
    undisturbed = Simulation(simulation.scene, threads=1)
    for _ in range(2):
        undisturbed.step()
    np.testing.assert_array_equal(simulation.cells.position, undisturbed.cells.position)


def test_a_handler_that_returns_changes_nothing_of_a_solve(handled):
    seen = []
    signal.signal(signal.SIGALRM, lambda number, frame: seen.append(number))
    runs = []
    for interval in (0.0, 1e-3):
        simulation = Simulation(SCENE.with_changes({"integrator.method": "cvode"}), threads=1)
        signal.setitimer(signal.ITIMER_REAL, interval, interval)
        for _ in range(20):
            simulation.step()
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        runs.append(simulation)
    assert len(seen) > 5
    np.testing.assert_array_equal(runs[0].cells.position, runs[1].cells.position)


# the harness

READY = "from multicell.__main__ import run; print('ready', flush=True); run()"
AIMED = """
import os, random, signal, sys, threading, time
from multicell.results import folder, journal

def press():
    for _ in range(PRESSES):
        time.sleep(draw.uniform(0.0, 0.02))
        os.kill(os.getpid(), signal.SIGINT)

def new_file(path):
    if WANTED in path.name and next(left) == 0:
        threading.Thread(target=press, daemon=True).start()
    return usual(path)

draw, left, usual = random.Random(CASE), iter(range(NUMBER, -1 << 30, -1)), folder.new_file
folder.new_file = journal.new_file = new_file
"""
"""Presses Ctrl-C from the moment on at which the process begins to write a file."""

RUNS = """
import multicell as mc
print("ready", flush=True)
result = None
try:
    scene = mc.load_scene("growth").with_changes({"initial.count": 100, "duration": "2 h"})
    for number in range(1000):
        result = mc.run(scene, output="out", overwrite=True, threads=1)
        result = mc.resume("out", changes={"duration": "3 h"}, threads=1)
        mc.export(result, "tables", format="netcdf", overwrite=True)
except KeyboardInterrupt:
    print("whole", result, flush=True)
    raise SystemExit(130)
"""
LOOP = """
import multicell as mc
print("ready", flush=True)
simulation = None
try:
    simulation = mc.Simulation(mc.load_scene("growth").with_changes(
        {"initial.count": 300, "duration": "90 d", "integrator.method": METHOD}), threads=1)
    while not simulation.finished:
        simulation.step()
except KeyboardInterrupt:
    energy = None if simulation is None else simulation.energy()
    print("whole", energy, flush=True)
    raise SystemExit(130)
"""
LONG, SHORT = "9 d", "3 h"  # the end of a short one comes soon, and with it all that is written
AT_THE_END = re.compile(
    r"Exception ignored in(: <module 'threading'| atexit callback: )[^\n]*\n"
    r"Traceback[^\n]*\n( [^\n]*\n)+KeyboardInterrupt: \n"
)
DATA = "time / h,diameter / um\n6,60\n12,70\n18,80\n"


def _commands(folder, duration):
    """Return commands by name, and the preparation that they need."""
    out, small = folder / "out", _small(duration)
    free = ["--free", "growth.cycle_time=18:30 h", "--cores", "1", "--yes"]
    last = "9 d" if duration == LONG else "30 min"
    return {
        "run": ["run", "growth", "-o", out, *small, "--set", "output.every=10 min"],
        "spheroid": ["run", "spheroid", "-o", out, "--threads", "1", "--set", f"duration={last}"],
        "resume": ["resume", out, "--set", f"duration={duration}"],
        "compare": ["compare", "growth", *small, "-o", folder / "chart"],
        "stability": ["stability", "settle", "-o", folder / "chart"],
        "study": ["study", "run", folder / "study", "--cores", "1", "--yes"],
        "sensitivity": ["sensitivity", "growth", *small, "-o", folder / "indices", *free],
        "fit": ["fit", "growth", *small[:2], "-o", folder / "fit", "--data", folder / "data.csv",
                *free],
        "explain": ["explain", "spheroid"],
        "doses": ["dose-response", "growth", *small, "--seeds", "1", "--cores", "1", "--yes",
                  "-o", folder / "doses", "--dose", "growth.cycle_variation=0,0.1,0.2,0.3,0.4"],
        "export": ["export", out, "-o", folder / "tables", "--format", "netcdf", "--overwrite"],
    }  # fmt: skip


def _small(duration):
    return ["--set", "initial.count=100", "--set", f"duration={duration}"]


def _multicell(*arguments):
    done = subprocess.run(
        [sys.executable, "-m", "multicell", *map(str, arguments)], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr


def _prepare(name, folder, duration):
    if name in ("resume", "export"):
        out = folder / "out"
        _multicell("run", "growth", "-o", out, *_small("1 h"), "--no-report", "--quiet")
    (folder / "data.csv").write_text(DATA)
    if name == "study":
        _multicell("study", "new", "growth", "-o", folder / "study", *_small(duration),
                   "--vary", "growth.cycle_time=18,24,30 h")  # fmt: skip


SWALLOWED = """
import os, signal, time
from multicell.host import interrupts
interrupts.watch_command()
import numpy as np
from scipy.stats import qmc
real = np.load
def load(*arguments, **options):
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(0.1)
    return real(*arguments, **options)
np.load = load
try:
    qmc.Sobol(2)
    time.sleep(5.0)
    print("swallowed")
except KeyboardInterrupt:
    print("raised", interrupts.interrupted())
"""


@pytest.mark.slow
def test_compiled_code_of_others_that_swallows_an_interrupt_neither_prints_nor_keeps_it():
    """SciPy's reads the numbers of Sobol' sequences once, and prints what is raised in that."""
    done = subprocess.run(
        [sys.executable, "-c", SWALLOWED], capture_output=True, text=True, timeout=60,
        preexec_fn=listening,
    )  # fmt: skip
    assert done.stdout == "raised True\n"
    assert done.stderr == ""


PRESSED_AGAIN = SWALLOWED.replace(
    "import numpy as np",
    """
import threading
start = threading.Timer.start
def start_and_press(timer):
    os.kill(os.getpid(), signal.SIGINT)
    start(timer)
threading.Timer.start = start_and_press
import numpy as np""",
    1,
)


@pytest.mark.slow
def test_a_press_while_a_press_is_raised_again_prints_nothing():
    done = subprocess.run(
        [sys.executable, "-c", PRESSED_AGAIN], capture_output=True, text=True, timeout=60,
        preexec_fn=listening,
    )  # fmt: skip
    assert (done.stdout, done.stderr) == ("raised True\n", "")


NO_THREAD = SWALLOWED.replace(
    "import numpy as np",
    """
import threading
def refuse(timer):
    raise RuntimeError("can't start new thread")
threading.Timer.start = refuse
import numpy as np""",
    1,
).replace(
    "    time.sleep(5.0)",
    """    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(5.0)""",
    1,
)


@pytest.mark.slow
def test_a_press_that_cannot_be_raised_again_does_not_swallow_the_next():
    done = subprocess.run(
        [sys.executable, "-c", NO_THREAD], capture_output=True, text=True, timeout=60,
        preexec_fn=listening,
    )  # fmt: skip
    assert done.stdout == "raised True\n"


def _interrupted(command, environment, moments, cwd):
    """Return exit code and output of a process with a Ctrl-C at each moment, s after the last."""
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=cwd,
        env={**os.environ, **environment}, preexec_fn=listening,
    )  # fmt: skip
    assert process.stdout.readline() == "ready\n"
    patience = Patience(process.pid, 180.0 + sum(moments), time.monotonic())
    for moment in moments:
        time.sleep(moment)
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
    while not patience.ended(time.monotonic()):
        with contextlib.suppress(subprocess.TimeoutExpired):
            output, errors = process.communicate(timeout=5)
            return process.returncode, output, errors
    process.send_signal(signal.SIGABRT)  # with PYTHONFAULTHANDLER it says where it is
    output, errors = process.communicate()
    return "hung", output, errors


def _read_back(folder):
    """Read all that is in place in a folder; raises an error where something is not whole."""
    for path in folder.rglob("*"):
        if path.name in ("frames.h5", "frames.journal") and path.stat().st_size:
            contents = Contents(path.parent)
            contents.whole()
            contents.history()
            for place in range(len(contents.places)):
                contents.frame(place)
        elif path.name in ("summary.json", "failure.json", "study.json"):
            assert read_document(path) is not None
        elif path.name == "search.log":
            assert Lines(path).entries is not None
        elif path.name == "scene.toml":
            mc.load_scene(path)
        elif path.suffix in (".nc", ".h5ad") and ".export-" not in str(path):
            check_readable(path)
        elif path.suffix == ".json":
            json.loads(path.read_text())


@pytest.mark.harness
@pytest.mark.slow
def test_interrupts_at_any_moment_end_in_one_word(tmp_path, request):
    found, first = [], request.config.getoption("--first-seed")
    for case in range(first, first + request.config.getoption("--interrupts")):
        rng = random.Random(case)
        folder = tmp_path / str(case)
        folder.mkdir()
        names = [*_commands(folder, LONG), "loop auto", "loop cvode", "runs"]
        name = names[case % len(names)]
        presses = rng.choice([1, 2, 2, 3])
        # half of them when something is written: frames.h5, or any file
        aimed = rng.random() < 0.5 and name not in ("stability", "explain", *names[-3:-1])
        environment = {"PYTHONFAULTHANDLER": "1"} if rng.random() < 0.5 else {}
        if rng.random() < 0.4:
            environment["NUMBA_CACHE_DIR"] = str(folder / "cache")
        moments = [rng.uniform(0.0, 8.0), *(rng.uniform(0.0, 0.5) for _ in range(presses - 1))]
        if name in ("study", "sensitivity", "fit", "doses", "runs"):
            moments[0] *= 2.0
        aim, duration = "", SHORT if aimed else LONG
        if aimed:
            wanted, number = rng.choice([("frames.h5", 0), ("", rng.randrange(4))])
            aim = (AIMED.replace("CASE", str(case)).replace("PRESSES", str(presses))
                   .replace("WANTED", repr(wanted)).replace("NUMBER", str(number)))  # fmt: skip
            moments = []
        if name == "runs":
            command = [sys.executable, "-c", aim + RUNS]
        elif name.startswith("loop"):
            program = LOOP.replace("METHOD", repr(name.split()[1]))
            command = [sys.executable, "-c", program]
            moments[0] = rng.uniform(5.0, 15.0)
        else:
            _prepare(name, folder, duration)
            told = map(str, _commands(folder, duration)[name])
            command = [sys.executable, "-c", aim + READY, *told]
        code, output, errors = _interrupted(command, environment, moments, folder)
        told = (case, name, presses, aim[-300:], moments, environment, code, output[-500:],
                errors[-1500:])  # fmt: skip
        if name.startswith("loop") or name == "runs":
            fine = code == 130 and "whole" in output and errors == ""
            # the program of a user who presses once more while it says so
            fine |= presses > 1 and errors.rstrip().endswith("\nKeyboardInterrupt")
            # or while Python takes leave, after it has said so
            fine |= presses > 1 and "whole" in output and bool(AT_THE_END.fullmatch(errors))
        else:
            fine = code == 0 or (code == 130 and errors.rstrip().endswith("Interrupted."))
            fine &= not any(word in errors for word in ("Traceback", "ignored", "Fatal", " bug "))
        fine |= name == "doses" and "There is no curve to fit" in errors
        # Python itself ends so where Ctrl-C comes once more while it ends
        fine |= code == -signal.SIGINT and presses > 1 and errors == ""
        try:
            _read_back(folder)
        except Exception as error:
            fine, told = False, (*told, repr(error))
        if not fine:
            found.append(told)
    assert found == [], json.dumps(found, indent=1, default=str)


@pytest.mark.parametrize("count", [2, 3, 5])
def test_a_row_that_is_cut_off_is_made_again(count, tmp_path, monkeypatch):
    scene = SCENE.with_changes({"duration": "2 h", "output.every": "40 min"})
    mc.run(scene, output=tmp_path / "whole", threads=1)
    append, calls = Store.append_history, []

    def pressed(self, row):
        calls.append(row)
        if len(calls) == count:
            raise KeyboardInterrupt
        append(self, row)

    with monkeypatch.context() as patch:
        patch.setattr(Store, "append_history", pressed)
        with contextlib.suppress(KeyboardInterrupt):  # what a second Ctrl-C in it leaves
            mc.run(scene, output=tmp_path / "cut", threads=1)
    assert len(calls) == count
    mc.resume(tmp_path / "cut", threads=1)
    assert_same_bits(tmp_path / "cut", tmp_path / "whole")
