"""Costs of tests in time of the processor: a plugin of pytest, and its table by file.

``PYTHONPATH=tests/helpers pytest -n auto -p costs --costs costs.jsonl`` writes a line for each
test, with the functions that it compiled and the time of processes that it waited for, and
``python tests/helpers/costs.py costs.jsonl`` prints the files and tests that cost most. An empty
``NUMBA_CACHE_DIR`` counts all that a first run compiles, and all that several workers compile.
"""

import collections
import gc
import json
import sys
import threading
import time
from pathlib import Path

import pytest
from numba.core import event

SHOWN = 40
"""Rows of each table."""
WIDTH = 160
"""Characters of a function with its types."""


class Compiled(event.Listener):
    """Notes what numba compiles, and how long that takes."""

    def __init__(self):
        self.seconds, self.names, self.took = 0.0, [], collections.Counter()
        self._here = threading.local()

    def on_start(self, begun):
        """Begin a function, in one that is being compiled or not."""
        self._here.depth = getattr(self._here, "depth", 0) + 1
        if self._here.depth == 1:
            self._here.begin = time.thread_time()

    def on_end(self, ended):
        """End a function."""
        function = ended.data["dispatcher"].py_func
        name = f"{function.__module__}.{function.__qualname__}"
        self.names.append(f"{name} {ended.data['args']}")
        self._here.depth -= 1
        if self._here.depth == 0:  # with all functions that it calls
            took = time.thread_time() - self._here.begin
            self.seconds += took
            self.took[name] += took


class Collected:
    """Counts the time in which Python searches for cyclic garbage."""

    def __init__(self):
        self.seconds = self._begin = 0.0

    def __call__(self, phase, _):
        """Note that the collector begins or ends."""
        if phase == "start":
            self._begin = time.thread_time()
        else:
            self.seconds += time.thread_time() - self._begin


class Costs:
    """Writes the cost of each test to a file, to which other workers write too."""

    def __init__(self, path):
        self.path, self.compiled, self.collected = path, Compiled(), Collected()
        event.register("numba:compile", self.compiled)
        gc.callbacks.append(self.collected)

    @pytest.hookimpl(hookwrapper=True, tryfirst=True)
    def pytest_runtest_protocol(self, item):
        """Measure a test with its fixtures."""
        others, compiled = spent(), self.compiled.seconds
        collected = self.collected.seconds
        self.compiled.names.clear()
        self.compiled.took.clear()
        own = time.process_time()  # without the search for processes, some ms for each test
        yield
        own = time.process_time() - own
        row = {
            "test": item.nodeid,
            "slow": item.get_closest_marker("slow") is not None,
            "own": own,
            "others": spent() - others,
            "compiling": self.compiled.seconds - compiled,
            "garbage": self.collected.seconds - collected,
            "compiled": self.compiled.names,
            "took": self.compiled.took,
        }
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")


def spent():
    """Return the CPU time of this process, s, and of others that it has waited for or has now."""
    import psutil

    this, others = psutil.Process(), 0.0
    for child in this.children(recursive=True):
        try:
            others += sum(child.cpu_times()[:4])
        except psutil.Error:  # it has just ended
            continue
    own = this.cpu_times()
    return others + own.children_user + own.children_system


def pytest_addoption(parser):
    """Add the option with the file."""
    parser.addoption("--costs", type=Path, help="a file for what each test costs")


def pytest_configure(config):
    """Measure where the option asks for it, in each worker."""
    path = config.getoption("--costs")
    if path is not None and not getattr(config.option, "numprocesses", None):
        config.pluginmanager.register(Costs(path.absolute()))


def table(rows):
    """Return the lines of the account: sums, files and tests that cost most, repeated compiling."""
    files = collections.defaultdict(collections.Counter)
    compiled = collections.Counter(name for row in rows for name in row["compiled"])
    for row in rows:
        costs = {"cpu": row["own"] + row["others"], "short": 0.0, "tests": 1}
        costs["short"] = 0.0 if row["slow"] else costs["cpu"]
        costs |= {name: row[name] for name in ("others", "compiling", "garbage")}
        files[row["test"].partition("::")[0]].update(costs)
    heads = ("cpu", "short", "compiling", "others", "garbage", "tests")
    whole = sum(files.values(), collections.Counter())
    yield " ".join(f"{head:>9}" for head in heads)
    for name, costs in [("all", whole), *sorted(files.items(), key=lambda x: -x[1]["cpu"])[:SHOWN]]:
        yield " ".join(f"{costs[head]:9.1f}" for head in heads) + f"  {name}"
    again = sum(count - 1 for count in compiled.values())
    yield f"{compiled.total()} functions compiled, {again} of them again"
    took = sum((collections.Counter(row["took"]) for row in rows), collections.Counter())
    for name, seconds in took.most_common(SHOWN):
        yield f"{seconds:9.1f}  {name[:WIDTH]}"
    for row in sorted(rows, key=lambda row: -row["own"] - row["others"])[:SHOWN]:
        yield f"{row['own'] + row['others']:9.1f}  {row['test']}"


if __name__ == "__main__":
    lines = Path(sys.argv[1]).read_text("utf-8").splitlines()
    print("\n".join(table([json.loads(line) for line in lines])))
