"""Kernel of executed pages.

A line ``!command`` of a page that fails, fails the build: IPython goes on after such a line, so the
kernels of a build get a profile of their own whose start-up file makes it raise instead.

Kernels are reached through sockets that are files in that profile. Jupyter looks for five free
ports of the machine before a kernel takes them; where many start at once, two get the same one, a
kernel dies, and Sphinx then ends every page that is being read.

Pages are executed side by side, and each has one thread: more would wait for each other on the
same cores, and give the same bits.
"""

import functools
import os
import sys
import tempfile
import uuid
from pathlib import Path

from jupyter_client import AsyncKernelManager
from myst_nb.core.execute import direct
from sphinx.application import Sphinx

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
exec "{python}" -m multicell "$@"
"""


class SocketFileManager(AsyncKernelManager):
    """Start a kernel that is reached through files, which no other kernel can have."""

    def __init__(self, **settings: object) -> None:
        super().__init__(**settings)
        # short: a path of a socket has at most 107 bytes
        name = Path(os.environ["IPYTHONDIR"]) / uuid.uuid4().hex
        self.connection_file = f"{name}.json"
        self.transport = "ipc"
        self.ip = str(name)


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
    command.write_text(COMMAND.format(python=sys.executable))
    command.chmod(0o755)
    os.environ["PATH"] = os.pathsep.join([str(command.parent), os.environ["PATH"]])


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
