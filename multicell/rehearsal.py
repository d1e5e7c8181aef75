"""What a run may need compiled later on, compiled before it is needed, by another process.

A run that begins with one cell needs no forces before that has divided: meanwhile another process
goes over a coupling step of two cells that touch, in the run's own way
(:mod:`multicell.rehearsed`). What that compiles is in numba's cache on disk, where the run finds
it. In the same way other processes do what is needed by other methods that the run may choose
(``auto``) and by fields of many nodes. From some size on, threads share the loops over cells, in
code of its own: while the population is well below that size, it is compiled for the arguments
that the run has met. This changes no result, nor can it make a run fail: what is not done by then
is compiled when it is needed.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import time as clock
from contextlib import suppress
from importlib import import_module
from typing import TYPE_CHECKING, Any, Final, final

from multicell.threads import DRIVERS

if TYPE_CHECKING:
    from collections.abc import Mapping

    from multicell.scene.scene import Scene
    from multicell.simulation import Simulation

Work = list[tuple[str, str, Any]]
"""Module and name of jitted functions, with numba's types of their arguments."""

FIRST_CONTACT, OTHER_METHODS, MANY_NODES = "first_contact", "other_methods", "many_nodes"
"""What :mod:`multicell.rehearsed` can do."""
SHARED_LOOPS = "shared_loops"
"""The drivers for all threads (:data:`multicell.threads.DRIVERS`)."""

_EARLY = 0.125
"""Part of the size from which on something else is needed at which the other process starts."""
_LONG = 3.0
"""Wall time of a run, s, after which other methods are compiled."""
_LONGEST_WAIT = 30.0
"""How long the run waits for it at that size, s: longer than it takes on a slow machine."""


_OWN_GROWTH: Final = ("law", "target", "parameters")
"""Keys of growth that a law of the user's own takes."""


@final
class Rehearsal:
    """The processes that compile ahead of a run, one after the other, never longer than the run.

    Parameters
    ----------
    scene
        What the run is of.
    threads
        How many the run has: with one, no core but that is asked for.
    """

    def __init__(self, scene: Scene, threads: int = 2) -> None:
        self._scene = scene.to_dict()
        growth = self._scene.get("growth", {})
        if ":" in growth.get("law", ""):  # no compiled code depends on it
            self._scene["growth"] = {k: growth[k] for k in growth if k not in _OWN_GROWTH}
        self._process: subprocess.Popen[bytes] | None = None
        self._over = threads == 1 or not _worth_while()
        self._doing = ""
        self._wanted = {SHARED_LOOPS}
        if scene.integrator.method == "auto":
            self._wanted.add(OTHER_METHODS)
        if any(part.layout == "box" for part in scene.nutrients.values()):
            self._wanted.add(MANY_NODES)
        self._begin = clock.perf_counter()

    def begin(self, scene: Scene) -> None:
        """Start a process for what the first division will ask for, if the run has one cell."""
        if self._over or not _begins_alone(scene) or _known(scene):
            return
        self._doing = FIRST_CONTACT
        self._process = _started(self._scene, [], [FIRST_CONTACT], urgent=True)

    def watch(self, simulation: Simulation) -> None:
        """Start a process when its time has come, and be ready when the size is reached."""
        if self._over:
            return
        size, cells = simulation.shared_from, len(simulation.cells)
        if size is None:  # one thread: no core but this one is asked for
            self._over = True
            return
        if cells > 1:
            self._wait(FIRST_CONTACT)
        if cells >= size:
            self._wanted.discard(SHARED_LOOPS)
            self._wait(SHARED_LOOPS)
        if self._process is not None and self._process.poll() is None:
            if self._doing != OTHER_METHODS or not self._asks_for_drivers(size, cells):
                return
            # what may be needed gives way to what will be
            self._end()
            self._wanted.add(OTHER_METHODS)
        self._next(size, cells, simulation.nodes)

    def _asks_for_drivers(self, size: int, cells: int) -> bool:
        return SHARED_LOOPS in self._wanted and cells >= _EARLY * size

    def _next(self, size: int, cells: int, nodes: int) -> None:
        """Start the next process that is due."""
        lasting = clock.perf_counter() - self._begin > _LONG
        if self._asks_for_drivers(size, cells):
            work = [item for item in wanted_drivers() if not _on_disk(*item)]
            self._start(SHARED_LOOPS, work, wanted=bool(work))
        elif MANY_NODES in self._wanted and nodes >= _EARLY * _many():
            known = _any_on_disk("multicell.nutrient.multigrid_kernels", "prolong")
            self._start(MANY_NODES, [], wanted=nodes < _many() and not known)
        elif OTHER_METHODS in self._wanted and lasting and cells > 1:
            wanted = any(not _on_disk(*item) for item in wanted_methods())
            self._start(OTHER_METHODS, [], wanted=wanted)

    def _start(self, what: str, work: Work, *, wanted: bool) -> None:
        """Start a process for something, if it is not on disk yet."""
        self._wanted.discard(what)
        self._doing, self._process = what, None
        if wanted:
            self._process = _started(self._scene, work, [] if work else [what])

    def _wait(self, what: str) -> None:
        """Wait for the process that does something, once."""
        if self._doing == what and self._process is not None:
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(_LONGEST_WAIT)
            self._doing = ""

    def close(self) -> None:
        """End the process."""
        self._over = True
        self._end()

    def _end(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None


def _many() -> int:
    """Return the number of nodes from which on multigrid solves for a field."""
    from multicell.nutrient.steady import MANY  # scenes without fields load nothing of them

    return MANY


def _begins_alone(scene: Scene) -> bool:
    """Return whether a run begins with one cell that nothing moves."""
    moved = (scene.motility, scene.haptotaxis, scene.pull, scene.chemotaxis or None, scene.domain)
    if scene.forces or scene.motions:
        return False
    return scene.initial.count == 1 and scene.growth is not None and moved == (None,) * len(moved)


def _known(scene: Scene) -> bool:
    """Return whether the forces of a scene's law have been compiled, and the loop of ``auto``."""
    from numba import typeof

    from multicell.mechanics import forces
    from multicell.rehearsed import touching

    wanted = [forces.forces]
    if scene.integrator.method == "auto":
        from multicell.integrators.loops.adams_bashforth import adaptive_adams

        wanted.append(adaptive_adams)
    law = typeof(touching(scene, 2)[0]._law)  # type: ignore[no-untyped-call]
    return all(any(_names(law, kinds) for kinds in _listed(function)) for function in wanted)


def _names(wanted: Any, kinds: Any) -> bool:
    """Return whether a type is among those of the arguments of a function, or in one of these."""
    return any(wanted == kind or wanted in getattr(kind, "types", ()) for kind in kinds)


def _listed(function: Any) -> list[Any]:
    """Return for which types of arguments numba's cache holds a function."""
    index = getattr(getattr(function, "_cache", None), "_cache_file", None)
    return [] if index is None else [key[0] for key in index._load_index()]


def _any_on_disk(module: str, name: str) -> bool:
    """Return whether numba's cache holds a function for any types of arguments."""
    return bool(_listed(_function(module, name)))


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


def _started(
    scene: Mapping[str, Any], work: Work, acts: list[str], *, urgent: bool = False
) -> subprocess.Popen[bytes] | None:
    """Start a process, or do without; with as little claim to a core as may be, if not urgent."""
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
        pickle.dump((urgent, scene), pipe)
        pickle.dump((work, acts), pipe)
    return process


def compile_all(entries: Mapping[str, Any], work: Work, acts: list[str]) -> None:
    """Compile functions for types of arguments, and what a scene needs for what it may do."""
    for module, name, types in work:
        _function(module, name).compile(types)
    if acts:
        from multicell import rehearsed
        from multicell.scene.scene import Scene

        scene = Scene.from_dict(entries)
        for act in acts:
            getattr(rehearsed, act)(scene)


def main() -> None:
    """Compile what is asked for on standard input."""
    urgent, entries = pickle.load(sys.stdin.buffer)
    if hasattr(os, "nice") and not urgent:
        os.nice(10)
    law = str(entries["contact"]["law"])
    # types of constants are looked up by name, and those of laws of the user's own once loaded
    if ":" in law:
        from multicell.contact.custom import load_law

        load_law(law)
    else:
        import_module("multicell.contact.registry")
    work, acts = pickle.load(sys.stdin.buffer)
    compile_all(entries, work, acts)


if __name__ == "__main__":
    main()
