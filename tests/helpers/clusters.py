"""A Dask scheduler and its workers, started by their command lines as on a cluster."""

import os
import subprocess
import sys
from pathlib import Path

import multicell as mc

PACKAGE = str(Path(mc.__file__).parents[1])
HELPERS = str(Path(__file__).parent)


class Cluster:
    """Processes of a cluster; use it as a context manager."""

    def __init__(self, folder):
        self.folder, self.processes = folder, []

    def __enter__(self):
        self.address = f"tcp://127.0.0.1:{self.scheduler()}"
        return self

    def __exit__(self, *_):
        for process in reversed(self.processes):
            process.kill()
            process.wait()

    def scheduler(self):
        more = ["--host", "127.0.0.1", "--port", "0", "--dashboard-address", "127.0.0.1:0"]
        self.main = self._start("scheduler", more)
        for line in self.main.stderr:
            if "Scheduler at:" in line:
                return int(line.rpartition(":")[2])
        raise AssertionError("no scheduler")

    def worker(self, *more, path=PACKAGE):
        given = [self.address, "--nthreads", "1", "--no-dashboard", *more]
        process = self._start("worker", given, path)
        for line in process.stderr:
            if "Registered to:" in line:
                return process
        raise AssertionError("no worker")

    def _start(self, kind, more, path=PACKAGE):
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join([path, HELPERS])}
        environment["DASK_LOGGING__DISTRIBUTED"] = "info"
        process = subprocess.Popen(
            [sys.executable, "-m", f"distributed.cli.dask_{kind}", *more],
            env=environment, cwd=self.folder, text=True, stderr=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
        )  # fmt: skip
        self.processes.append(process)
        return process
