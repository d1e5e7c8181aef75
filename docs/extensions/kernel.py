"""Kernel of executed pages.

A line ``!command`` of a page that fails, fails the build: IPython goes on after such a line, so the
kernels of a build get a profile of their own whose start-up file makes it raise instead.

Kernels are reached through sockets that are files in that profile. Jupyter looks for five free
ports of the machine before a kernel takes them; where many start at once, two get the same one, a
kernel dies, and Sphinx then ends every page that is being read.

Kernels and commands are copies of one process (``copies.py``) where the system can split processes
off.

Pages are executed side by side, and each has one thread: more would wait for each other on the
same cores, and give the same bits.
"""

import functools
import os
import shlex
import sys
import tempfile
import uuid
from pathlib import Path

import copies
from environments import KERNEL
from jupyter_client import AsyncKernelManager
from myst_nb.core.execute import direct
from requirements import refused
from sphinx.application import Sphinx
from sphinx.errors import ExtensionError

STARTUP = """
def _system_that_raises():
    import subprocess

    from IPython import get_ipython

    shell = get_ipython()
    usual = shell.system

    def system(command):
        usual(command)
        code = shell.user_ns.get("_exit_code", 0)
        if code:
            raise subprocess.CalledProcessError(code, command)

    shell.system = system


_system_that_raises()
"""
THREADS = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
COMMAND = """#!/bin/sh
exec {words} "$@"
"""
COPY = [sys.executable, "-I", "-S", copies.__file__]


class SocketFileManager(AsyncKernelManager):
    """Start a kernel that is reached through files, which no other kernel can have."""

    def __init__(self, **settings: object) -> None:
        super().__init__(**settings)
        # short: a path of a socket has at most 107 bytes
        name = Path(os.environ["IPYTHONDIR"]) / uuid.uuid4().hex
        self.connection_file = f"{name}.json"
        self.transport = "ipc"
        self.ip = str(name)

    def format_kernel_cmd(self, extra_arguments: list[str] | None = None) -> list[str]:
        """Return the command that starts a kernel: one that asks for a copy."""
        command = super().format_kernel_cmd(extra_arguments)
        if not copies.able():
            return command
        return [*COPY, "kernel", *command[command.index("ipykernel_launcher") + 1 :]]


def profile(app: Sphinx) -> None:
    """Give the kernels that this build starts a profile that lasts as long as the build."""
    folder = tempfile.TemporaryDirectory(prefix="ipython-", ignore_cleanup_errors=True)
    app.connect("build-finished", lambda *_: folder.cleanup())
    startup = Path(folder.name) / "profile_default" / "startup"
    startup.mkdir(parents=True)
    (startup / "00-commands-that-fail.py").write_text(STARTUP)
    os.environ["IPYTHONDIR"] = folder.name
    # the command of the package that these pages are about, whatever else is installed
    command = Path(folder.name) / "bin" / "multicell"
    command.parent.mkdir()
    words = [*COPY, "command"] if copies.able() else [sys.executable, "-m", "multicell"]
    command.write_text(COMMAND.format(words=shlex.join(words)))
    command.chmod(0o755)
    os.environ["PATH"] = os.pathsep.join([str(command.parent), os.environ["PATH"]])
    if copies.able():
        # all that no page is without: the package alone, and what makes up a kernel
        server = copies.start(Path(folder.name), refused(["multicell", KERNEL]))

        # a kernel that waits longer than a minute for its start is given up
        def wait(*_: object) -> None:
            if server.stdout.readline() != b"loaded\n":
                raise ExtensionError(
                    "The process that commands and kernels are copies of has failed"
                )

        app.connect("env-before-read-docs", wait)
        app.connect("build-finished", lambda *_: server.communicate(), priority=400)


def setup(app: Sphinx) -> dict[str, bool]:
    """Tell Sphinx when to do it."""
    for name in THREADS:
        os.environ.setdefault(name, "1")
    app.connect("builder-inited", profile)
    if os.name == "posix":  # elsewhere ZeroMQ has no sockets that are files, and Sphinx one process
        direct.single_nb_execution = functools.partial(
            direct.single_nb_execution, kernel_manager_class=SocketFileManager
        )
    return {"parallel_read_safe": True, "parallel_write_safe": True}
