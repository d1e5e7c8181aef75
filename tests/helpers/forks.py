"""Processes that may be killed, crash or hang, at the price of a fork each.

``Forks`` starts one Python process that loads multicell and its kernels, and from then on splits
off a child for each task: a command line of ``multicell``, or a function of a test module.
"""

import atexit
import contextlib
import ctypes
import faulthandler
import gc
import importlib
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import psutil

import multicell

SERVER = "import sys, forks; sys.exit(forks.serve())"
WARM = {"duration": "20 min", "initial.count": 30}


class Patience:
    """How long to wait for a process: on a busy machine one that computes is slow and not hung."""

    def __init__(self, pid, limit, begin):
        self._process, self._limit, self._look = psutil.Process(pid), limit, begin + limit
        self._spent = -1.0

    def ended(self, now):
        """Return whether it had its time, s, of the processor or has stopped to use it."""
        if now < self._look:
            return False
        spent, self._look = processor_time(self._process), now + 20.0
        before, self._spent = self._spent, spent
        return spent > self._limit or spent < before + 0.1


def processor_time(process):
    """Return the CPU time of a process and those that it has started, s."""
    found, family = 0.0, []
    with contextlib.suppress(psutil.NoSuchProcess):  # any of them may end meanwhile
        family = [process, *process.children(recursive=True)]
    for one in family:
        with contextlib.suppress(psutil.NoSuchProcess):
            found += sum(one.cpu_times()[:4])
    return found


class Forks:
    """A process that splits off others; use it as a context manager."""

    def __enter__(self):
        package = Path(multicell.__file__).parents[1]
        paths = os.pathsep.join([str(package), str(Path(__file__).parent)])
        environment = {**os.environ, "PYTHONPATH": paths, "OMP_WAIT_POLICY": "passive"}
        self._process = subprocess.Popen(
            [sys.executable, "-c", SERVER],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=environment,
        )
        return self

    def __exit__(self, *_):
        self._process.stdin.close()
        self._process.wait(60)

    def ask(self, **task):
        """Do a task in a child and return its exit code (or minus a signal), output and time."""
        self._process.stdin.write(json.dumps(task) + "\n")
        self._process.stdin.flush()
        return json.loads(self._process.stdout.readline())

    def load(self, **task):
        """Do a task in a child, and load what it has loaded for all others; return its answer."""
        with tempfile.NamedTemporaryFile("w+") as names:
            done = self.ask(loads=names.name, **task)
            assert done["code"] == 0, done["text"]
            assert self.ask(load=json.load(names))["code"] == 0
        return done

    def multicell(self, *arguments, load=False, **options):
        """Do a command; ``load``: it must end well, and others find loaded what it needs."""
        do = self.load if load else self.ask
        return do(arguments=[str(a) for a in arguments], **options)


def serve():
    import multicell as mc
    from multicell.report import tables  # noqa: F401 - loaded once, for all children

    mc.run(mc.load_scene("spheroid").with_changes(WARM), threads=1)
    gc.freeze()  # a child's collector does not copy what it has of this process
    for line in sys.stdin:
        task = json.loads(line)
        if "load" in task:
            print(json.dumps({"code": _load(task["load"])}), flush=True)
            continue
        read, write = os.pipe()
        begin = time.monotonic()
        child = os.fork()
        if child == 0:
            os.close(read)
            _become(write, **task)
            _leave(_work(task) or 0)
        os.close(write)
        code = _watch(child, task, begin)
        with os.fdopen(read, errors="replace") as pipe:
            text = pipe.read(1 << 20)
        answer = {"code": code, "text": text, "seconds": time.monotonic() - begin}
        print(json.dumps(answer), flush=True)
    return 0


def _load(names):
    """Import modules that are there, and return zero."""
    for name in names:
        with contextlib.suppress(ImportError):
            importlib.import_module(name)
    gc.freeze()
    return 0


def _become(write, folder=".", memory=None, **_):
    """Send all output of this process to a pipe, and take no more tasks.

    It works in a folder, and with no more than some memory, bytes, beyond what it has.
    """
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(write, 1)
    os.dup2(write, 2)
    # a stream remembers whether what it writes to can be wound back, and a pipe cannot
    sys.stdout, sys.stderr = (os.fdopen(number, "w", closefd=False) for number in (1, 2))
    faulthandler.enable()
    os.chdir(folder)
    if memory is not None:
        limit_memory(memory)


def limit_memory(more):
    """Let this process have no more than some bytes of address space beyond what it has."""
    if Path("/proc/self/statm").exists():
        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + more, used + more))


def _work(task):
    """Do a task in this process, and return its exit code."""
    if "function" in task:
        module, _, name = task["function"].partition(":")
        code = getattr(__import__(module), name)(**task["with"]) or 0
    else:
        code = _command(task["arguments"])
    if "loads" in task:
        Path(task["loads"]).write_text(json.dumps(sorted(sys.modules)))
    return code


def _leave(code):
    """End this process as Python does, but for the two seconds in which it takes itself apart.

    Threads are waited for, what was to be done at the end is done, and libraries in C end by
    themselves: HDF5 closes its files.
    """
    threading._shutdown()
    gc.collect()
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    ctypes.CDLL(None).exit(int(code))


def _command(arguments):
    from multicell.cli.main import main

    try:
        main(arguments)
    except SystemExit as error:
        return error.code
    return 0


def _watch(child, task, begin):
    """Wait for a child, or kill it where the task says so; return its exit code."""
    patience = Patience(child, task.get("limit", 120.0), begin)
    kill_at = begin + task["kill_after"] if "kill_after" in task else None
    appears = task.get("kill_when")
    while True:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        now = time.monotonic()
        if appears is not None and kill_at is None and os.path.lexists(appears):
            kill_at = now + task.get("delay", 0.0)
        hung = patience.ended(now)
        if hung or (kill_at is not None and now > kill_at):
            if hung:  # it says where it stands
                os.kill(child, signal.SIGABRT)
                time.sleep(1.0)
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return "hung" if hung else -int(signal.SIGKILL)
        time.sleep(0.0005 if appears is not None and kill_at is None else 0.001)
