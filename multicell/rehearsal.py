"""What a growing population will need compiled, compiled before it is needed, by another process.

From some size on, threads share the loops over cells, in code of its own that takes seconds to
compile. While the population is well below that size, a process of its own compiles it for the
arguments that the run has met, into numba's cache on disk, where the run finds it. It changes no
result, nor can it make a run fail: what it has not done by then is compiled when it is needed.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from contextlib import suppress
from importlib import import_module
from typing import TYPE_CHECKING, Any, final

from multicell.threads import DRIVERS

if TYPE_CHECKING:
    from multicell.simulation import Simulation

_EARLY = 0.125
"""Part of the size from which threads share loops at which the other process starts."""
_LONGEST_WAIT = 30.0
"""How long the run waits for it at that size, s: longer than it takes on a slow machine."""


@final
class Rehearsal:
    """The process that compiles ahead of a run; at most one, and never longer than the run."""

    def __init__(self, law: str) -> None:
        self._law = law
        self._process: subprocess.Popen[bytes] | None = None
        self._over = not _worth_while()

    def watch(self, simulation: Simulation) -> None:
        """Start when the population comes near the size, and be ready when it is reached."""
        if self._over:
            return
        size = simulation.shared_from
        if size is None or len(simulation.cells) >= size:
            self._over = True
            if self._process is not None:
                with suppress(subprocess.TimeoutExpired):
                    self._process.wait(_LONGEST_WAIT)
        elif self._process is None and len(simulation.cells) >= _EARLY * size:
            self._process = _started(self._law)

    def close(self) -> None:
        """End the process."""
        self._over = True
        if self._process is not None:
            self._process.kill()
            self._process.wait()


def _worth_while() -> bool:
    """Return whether a core is free for another process."""
    known = getattr(os, "sched_getaffinity", None)
    cores = len(known(0)) if known else os.cpu_count() or 1
    return cores > 1


def wanted() -> list[tuple[str, str, Any]]:
    """Return module, name and types of arguments of all drivers that are not compiled yet."""
    return [
        (*name, types)
        for name, (serial, shared) in DRIVERS.items()
        for types in serial.overloads
        if types not in shared.overloads
    ]


def _started(law: str) -> subprocess.Popen[bytes] | None:
    """Start the process, or do without."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
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
        pickle.dump(wanted(), pipe)
    return process


def compile_all(law: str, work: list[tuple[str, str, Any]]) -> None:
    """Compile drivers for types of arguments, with the law of the user's own if there is one."""
    if ":" in law:
        from multicell.contact.custom import load_law

        load_law(law)
    else:
        import_module("multicell.contact.registry")
    for module, name, types in work:
        import_module(module)
        DRIVERS[module, name][1].compile(types)


def main() -> None:
    """Compile what is asked for on standard input, with as little claim to a core as possible."""
    if hasattr(os, "nice"):
        os.nice(10)
    law = pickle.load(sys.stdin.buffer)
    # types of constants are looked up by name, and those of laws of the user's own once loaded
    compile_all(law, pickle.load(sys.stdin.buffer))


if __name__ == "__main__":
    main()
