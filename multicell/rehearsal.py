"""What a run may need compiled later on, compiled before it is needed, by another process.

From some size on, threads share the loops over cells, in code of its own that takes seconds to
compile. While the population is well below that size, another process compiles it for the
arguments that the run has met, into numba's cache on disk, where the run finds it. In the same way
a run that takes long and chooses its method (``auto``) has RKC2 compiled, which contacts that
become stiff may ask for at any time. This changes no result, nor can it make a run fail: what is
not done by then is compiled when it is needed.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import time as clock
from contextlib import suppress
from importlib import import_module
from typing import TYPE_CHECKING, Any, final

from multicell.threads import DRIVERS

if TYPE_CHECKING:
    from multicell.scene.scene import Scene
    from multicell.simulation import Simulation

Work = list[tuple[str, str, Any]]
"""Module and name of jitted functions, with numba's types of their arguments."""

_EARLY = 0.125
"""Part of the size from which threads share loops at which the other process starts."""
_LONG = 10.0
"""Wall time of a run, s, after which other methods are compiled."""
_LONGEST_WAIT = 30.0
"""How long the run waits for it at that size, s: longer than it takes on a slow machine."""


@final
class Rehearsal:
    """The processes that compile ahead of a run, one after the other, never longer than the run."""

    def __init__(self, scene: Scene) -> None:
        self._law = str(scene.to_dict()["contact"]["law"])
        self._process: subprocess.Popen[bytes] | None = None
        self._over = not _worth_while()
        self._drivers_wanted, self._reached = True, False
        self._methods_wanted = scene.integrator.method == "auto"
        self._begin = clock.perf_counter()

    def watch(self, simulation: Simulation) -> None:
        """Start a process when its time has come, and be ready when the size is reached."""
        if self._over:
            return
        size, cells = simulation.shared_from, len(simulation.cells)
        if size is None:  # one thread: no core but this one is asked for
            self._over = True
            return
        if cells >= size and not self._reached:
            self._reached, self._drivers_wanted = True, False
            self._wait()
        if self._process is not None and self._process.poll() is None:
            return
        if self._drivers_wanted and cells >= _EARLY * size:
            self._drivers_wanted = False
            self._start(wanted_drivers())
        elif self._methods_wanted and clock.perf_counter() - self._begin > _LONG:
            self._methods_wanted = False
            self._start(wanted_methods())

    def close(self) -> None:
        """End the process."""
        self._over = True
        if self._process is not None:
            self._process.kill()
            self._process.wait()

    def _start(self, work: Work) -> None:
        """Start a process for what is not on disk yet."""
        work = [item for item in work if not _on_disk(*item)]
        self._process = _started(self._law, work) if work else None

    def _wait(self) -> None:
        if self._process is not None:
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(_LONGEST_WAIT)


def _worth_while() -> bool:
    """Return whether a core is free for another process."""
    known = getattr(os, "sched_getaffinity", None)
    cores = len(known(0)) if known else os.cpu_count() or 1
    return cores > 1


def wanted_drivers() -> Work:
    """Return all drivers for all threads that the run may need, as far as it has shown."""
    return [
        (*name, types)
        for name, (serial, shared) in DRIVERS.items()
        for types in serial.overloads
        if types not in shared.overloads
    ]


def wanted_methods() -> Work:
    """Return the loop of RKC2 for what the loop of Adams-Bashforth has been called with."""
    loop = sys.modules.get("multicell.integrators.loops.adams_bashforth")
    seen = () if loop is None else loop.adaptive_adams.overloads
    return [
        ("multicell.integrators.loops.chebyshev", "adaptive_chebyshev", types) for types in seen
    ]


def _function(module: str, name: str) -> Any:
    """Return a jitted function."""
    loaded = import_module(module)
    known = DRIVERS.get((module, name))
    return getattr(loaded, name) if known is None else known[1]


def _on_disk(module: str, name: str, types: Any) -> bool:
    """Return whether numba's cache holds a function for types of arguments."""
    function = _function(module, name)
    return function._cache.load_overload(types, function.targetctx) is not None


def _started(law: str, work: Work) -> subprocess.Popen[bytes] | None:
    """Start a process, or do without."""
    # an empty place is the folder that this process is in
    places = [place or os.getcwd() for place in sys.path]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(places)}
    nowhere = subprocess.DEVNULL
    try:
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", "multicell.rehearsal"],
            stdin=subprocess.PIPE, stdout=nowhere, stderr=nowhere, env=environment,
        )  # fmt: skip
    except OSError:
        return None
    assert process.stdin is not None
    with suppress(OSError), process.stdin as pipe:
        pickle.dump(law, pipe)
        pickle.dump(work, pipe)
    return process


def compile_all(law: str, work: Work) -> None:
    """Compile functions for types of arguments, with the law of the user's own if there is one."""
    if ":" in law:
        from multicell.contact.custom import load_law

        load_law(law)
    else:
        import_module("multicell.contact.registry")
    for module, name, types in work:
        _function(module, name).compile(types)


def main() -> None:
    """Compile what is asked for on standard input, with as little claim to a core as possible."""
    if hasattr(os, "nice"):
        os.nice(10)
    law = pickle.load(sys.stdin.buffer)
    # types of constants are looked up by name, and those of laws of the user's own once loaded
    compile_all(law, pickle.load(sys.stdin.buffer))


if __name__ == "__main__":
    main()
