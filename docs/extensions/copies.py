"""Commands and kernels of pages as copies of one process that has loaded the package.

Each ``multicell …`` of a page, and each kernel, would load the same modules and kernels for one or
two seconds. One process loads them (:func:`serve`) and splits off a copy of itself for each. Who
asks (:func:`ask`, or this file as a program) hands on its arguments, folder, environment and
streams, passes signals on, and ends as the copy does; if it is killed, so is the copy.

Only modules of the package's own requirements are loaded, and what makes up a kernel: a copy finds
the packages that its environment names (:mod:`environments`), and no others.
"""

import atexit
import contextlib
import ctypes
import gc
import json
import os
import selectors
import shlex
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import traceback
from pathlib import Path

ADDRESS = "MULTICELL_COPIES"
"""Variable with the path of the server's socket, of at most 107 bytes."""
SERVER = "import sys; sys.path[:] = filter(None, sys.path); import copies; copies.serve()"
SIZE = struct.Struct("<Q")
SHORT = "--set duration=20min --set initial.count=30 --set output.every=10min"


def able() -> bool:
    """Return whether this system can split processes off and wait for them as files."""
    return hasattr(os, "pidfd_open") and hasattr(socket, "send_fds")


def ask(kind: str, arguments: list[str]) -> int:
    """Let a copy run a ``command`` or a ``kernel`` with the streams of this process.

    Returns
    -------
    int
        Its exit code, or minus the number of the signal that ended it.
    """
    deaf = signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    task = {"kind": kind, "arguments": arguments, "folder": os.getcwd(), "deaf": deaf}
    text = json.dumps({**task, "variables": {**os.environ}}).encode()
    with socket.socket(socket.AF_UNIX) as server:
        server.connect(os.environ[ADDRESS])
        socket.send_fds(server, [SIZE.pack(len(text))], [0, 1, 2])
        server.sendall(text)
        with server.makefile() as answers:
            copy = int(answers.readline())
            for number in (signal.SIGINT, signal.SIGTERM):
                signal.signal(number, lambda sent, _: os.kill(copy, sent))
            return int(answers.readline())


def start(folder: Path, refused: set[str]) -> subprocess.Popen[bytes]:
    """Start the process that is copied, and set its address for who asks.

    It writes a line when all is loaded, and ends when its input does.

    - ``refused``: modules that some page must not find, which a library may load if they are there
    """
    os.environ[ADDRESS] = str(folder / "copies")
    paths = [str(Path(__file__).parent), *filter(None, [os.environ.get("PYTHONPATH")])]
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(os.environ[ADDRESS])
        listening.listen(128)  # who asks before all is loaded waits
        return subprocess.Popen(
            [sys.executable, "-c", SERVER, str(listening.fileno())],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={
                **os.environ,
                "PYTHONPATH": os.pathsep.join(paths),
                "REFUSED_MODULES": ",".join(sorted(refused)),
            },
            pass_fds=[listening.fileno()],
            start_new_session=True,
        )


def load() -> None:
    """Load what commands and kernels need, by short commands; none of them starts a thread."""
    import ipykernel.kernelapp  # noqa: F401

    from multicell.cli.main import main

    with tempfile.TemporaryDirectory() as name, open(os.devnull, "w") as nowhere:
        run, picture = f"{name}/run", f"{name}/picture.png"
        with contextlib.redirect_stdout(nowhere), contextlib.redirect_stderr(nowhere):
            for words in (
                f"run spheroid -o {run} --threads 1 {SHORT}",
                f"resume {run} --set duration=30min --threads 1 --no-report",
                f"plot {run} -o {picture}",
                "explain spheroid",
            ):
                main(shlex.split(words), standalone_mode=False)


def serve() -> None:
    """Split off a copy for each who asks, until the input of this process ends."""
    load()
    gc.collect()
    gc.freeze()  # collectors of copies leave alone what is there
    print("loaded", flush=True)
    with selectors.DefaultSelector() as waiting:
        listening = socket.socket(fileno=int(sys.argv[1]))
        waiting.register(listening, selectors.EVENT_READ)
        waiting.register(sys.stdin, selectors.EVENT_READ)
        copies: dict[socket.socket, tuple[int, int]] = {}  # with the copy and a file for its end
        while True:
            for key, _ in waiting.select():
                if key.fileobj is sys.stdin:
                    for copy, _ in copies.values():
                        os.kill(copy, signal.SIGKILL)
                    return
                if key.fileobj is listening:
                    asking, _ = listening.accept()
                    if copy := _split_off(asking, waiting):
                        copies[asking] = copy, os.pidfd_open(copy)
                        waiting.register(asking, selectors.EVENT_READ)
                        waiting.register(copies[asking][1], selectors.EVENT_READ, asking)
                elif key.data is None:  # who asked is gone
                    if key.fileobj in copies:  # and the copy was there until now
                        os.kill(copies[key.fileobj][0], signal.SIGKILL)
                        waiting.unregister(key.fileobj)
                else:
                    asking = key.data
                    copy, end = copies.pop(asking)
                    code = os.waitstatus_to_exitcode(os.waitpid(copy, 0)[1])
                    with contextlib.suppress(OSError):  # gone, too
                        asking.sendall(f"{code}\n".encode())
                    waiting.unregister(end)
                    os.close(end)
                    if asking in waiting.get_map():
                        waiting.unregister(asking)
                    asking.close()


def _split_off(asking: socket.socket, waiting: selectors.BaseSelector) -> int:
    """Return the number of a copy that does what is asked for, or 0 if that is not understood."""
    head, streams, _, _ = socket.recv_fds(asking, SIZE.size, 3)
    try:
        if len(head) < SIZE.size:
            asking.close()
            return 0
        (length,) = SIZE.unpack(head)
        with asking.makefile("rb") as file:
            text = file.read(length)
        if len(text) < length:  # who asked is gone
            asking.close()
            return 0
        task = json.loads(text)
        copy = os.fork()
        if copy == 0:
            code = 1
            try:
                for key in list(waiting.get_map().values()):
                    if key.fileobj is not sys.stdin:
                        os.close(key.fd)
                asking.close()
                _become(task, streams)
                code = _run(task["kind"])
            except BaseException:  # as Python says it at the end of a process
                traceback.print_exc()
            finally:
                _leave(code)
        with contextlib.suppress(OSError):  # gone since: seen as such, and the copy is ended
            asking.sendall(f"{copy}\n".encode())
        return copy
    finally:
        for stream in streams:
            os.close(stream)


def _become(task: dict, streams: list[int]) -> None:
    """Take folder, variables, arguments, streams and heed of interrupts of who asks."""
    os.setsid()
    signal.signal(signal.SIGINT, signal.SIG_IGN if task["deaf"] else signal.default_int_handler)
    for number, stream in enumerate(streams):
        os.dup2(stream, number)
    sys.stdin = open(0, closefd=False)  # noqa: SIM115
    sys.stdout, sys.stderr = (open(number, "w", closefd=False) for number in (1, 2))  # noqa: SIM115
    os.chdir(task["folder"])
    os.environ.clear()
    os.environ.update(task["variables"])
    sys.argv = ["multicell", *task["arguments"]]
    if filtered := sys.modules.get("sitecustomize"):  # of an executed page
        filtered.REFUSED = frozenset(os.environ.get("REFUSED_MODULES", "").split(","))
        loaded = {name.partition(".")[0] for name in sys.modules} & filtered.REFUSED
        assert not loaded, f"{loaded} are loaded and not of this page's environment"


def _run(kind: str) -> int:
    """Run the command or kernel with the arguments of this process; return its exit code."""
    try:
        if kind == "kernel":
            import matplotlib
            from ipykernel import kernelapp

            # as if matplotlib were imported in the kernel, which names the backend for pages
            matplotlib.rcParams["backend"] = "module://matplotlib_inline.backend_inline"
            # a kernel ends after its parent
            kernelapp.launch_new_instance(parent_handle=os.getppid())
        else:
            from multicell.__main__ import run

            run()
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else int(end.code is not None)
    return 0


def _leave(code: int) -> None:
    """End as Python does, but take no modules apart; libraries in C end by themselves."""
    threading._shutdown()
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    ctypes.CDLL(None).exit(code)


if __name__ == "__main__":
    ended = ask(sys.argv[1], sys.argv[2:])
    if ended < 0:
        signal.signal(-ended, signal.SIG_DFL) if -ended != signal.SIGKILL else None
        os.kill(os.getpid(), -ended)
    sys.exit(ended)
