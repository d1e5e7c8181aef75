"""A line ``!command`` of an executed page that fails, fails the build.

IPython goes on after such a line. The kernels of a build get a profile of their own whose start-up
file makes it raise instead.
"""

import os
import sys
import tempfile
from pathlib import Path

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
COMMAND = """#!/bin/sh
exec "{python}" -m multicell "$@"
"""


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
    app.connect("builder-inited", profile)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
