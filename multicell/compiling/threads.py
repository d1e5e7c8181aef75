"""Number of threads that kernels may use, and how these share loops."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from itertools import pairwise
from types import FunctionType, TracebackType
from typing import TYPE_CHECKING, Any, Final, Self, final

from multicell.errors import SceneError

if TYPE_CHECKING:
    from concurrent.futures import ThreadPoolExecutor


@final
class _Numba:
    """State of numba's threads in this process.

    - ``launched``: whether they were started
    - ``forked``: whether that was in the process that this one was forked from: they are not here
    - ``single``: whether only one thread of Python can have them (of the layer ``workqueue``)
    - ``owner``: which one has
    """

    launched = forked = single = False
    owner: threading.Thread | None = None


def _after_fork() -> None:
    _Numba.forked = _Numba.forked or _Numba.launched


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)

_CLAIM: Final = threading.Lock()


def may_share() -> bool:
    """Return whether the caller may share loops among numba's threads, which have been started.

    A process that was forked after that would wait for them for ever. Numba's own layer
    (``workqueue``) ends the process where two threads of Python come to it at once: there the first
    one has it until it ends. Who may not does all alone: the same bits.
    """
    if _Numba.forked or not _Numba.single:
        return not _Numba.forked
    with _CLAIM:
        if _Numba.owner is None or not _Numba.owner.is_alive():
            _Numba.owner = threading.current_thread()
        return _Numba.owner is threading.current_thread()


def thread_count(wanted: int | None) -> int:
    """Return the number of threads to use, and let numba know it.

    - ``wanted``: number of threads, or None for all that there are
    """
    import numba

    most = int(numba.config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]
    if wanted is None:
        wanted = most
    if not hasattr(wanted, "__index__") or not 1 <= wanted <= most:
        raise SceneError(
            "threads",
            f"is {wanted!r}, must be a number from 1 to {most}",
            "NUMBA_NUM_THREADS sets the limit.",
        )
    if _Numba.forked:
        return 1
    if wanted > 1:
        launch()
        numba.set_num_threads(wanted)
    return wanted


def launch() -> None:
    """Start numba's threads, if they have not been started yet.

    Numba starts them when it loads a parallel function from its disk cache, but not for a function
    that was compiled together with a cached parallel one and calls it: that ends in a crash.

    Threads of GNU OpenMP without work turn in a circle and keep their cores from other processes
    unless the environment says otherwise by now: with as many processes as cores, two threads took
    three times as long as one. To wake one that sleeps takes less than a hundredth of a loop.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    import numba

    numba.get_num_threads()
    _Numba.launched = True
    _Numba.single = numba.threading_layer() == "workqueue"  # type: ignore[attr-defined]


def two_drivers(body: Callable[..., Any]) -> tuple[Any, Any]:
    """Return a loop over chunks compiled twice: for one thread, and for all of them.

    Written once with ``numba.prange``, which is ``range`` in the first. The second stands under a
    name of its own, ``…_parallel``, so that each has its own file in numba's disk cache. Chunks
    that write to their own cells only give the same bits in both. Neither is compiled before it
    is called.
    """
    from numba import njit

    from multicell.compiling.options import KERNEL

    name = f"{body.__name__}_parallel"
    twin = FunctionType(body.__code__, body.__globals__, name, body.__defaults__, body.__closure__)
    twin.__qualname__, twin.__module__ = name, body.__module__
    serial = njit(**KERNEL)
    shared = njit(**KERNEL, parallel=True)
    return serial(body), shared(twin)


_RESTING: Final[dict[int, tuple[int, ThreadPoolExecutor]]] = {}
"""Threads without a team, and how many they are with a caller, by process: the most so far.

A dictionary's single operations are whole, so that no two teams come to have the same threads.
"""


def _taken(threads: int) -> tuple[int, ThreadPoolExecutor]:
    """Return threads that rest, or new ones in place of too few, for a team of so many."""
    from concurrent.futures import ThreadPoolExecutor

    if (found := _RESTING.pop(os.getpid(), None)) is not None:
        if found[0] >= threads:
            return found
        found[1].shutdown()
    return threads, ThreadPoolExecutor(threads - 1)


_WORTH = 20_000  # least number of rows for which a thread is woken


def share_rows(threads: int, body: Callable[[int, int], None], count: int) -> None:
    """Call ``body(begin, end)`` for parts of so many rows, one a thread where that is worth it."""
    with Team(max(1, min(threads, count // _WORTH))) as team:
        team.share(body, count)


@final
class Team:
    """Threads of the interpreter that share loops of kernels that release its lock.

    In place of numba's own where passes are few and long: nothing is compiled twice, and a thread
    that waits for another one sleeps, and loses little beside a process that occupies all cores. A
    context, at whose end the threads rest for the next one: to start one takes 0.1 ms.

    - ``threads``: how many; with one, all is done by the caller
    """

    def __init__(self, threads: int = 1) -> None:
        self.threads = threads
        self._process = os.getpid()  # one that is forked from it has none of the threads
        self._others: ThreadPoolExecutor | None = None
        if threads > 1:
            self._most, self._others = _taken(threads)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._others is None or os.getpid() != self._process:
            return
        if error is not None:  # some may still be at work
            self._others.shutdown()
            return
        rest, found = (self._most, self._others), _RESTING.pop(self._process, None)
        if found is not None:  # those of a team within this one, or beside it
            fewer, rest = sorted((found, rest), key=lambda threads: threads[0])
            fewer[1].shutdown()
        _RESTING[self._process] = rest  # threads that another team just put there end as unused

    def at_most(self, threads: int) -> Team:
        """Return the same threads, but no more than so many of them, for less work."""
        if threads >= self.threads:
            return self
        fewer = object.__new__(Team)  # copy.copy asks more than a loop takes that few share
        vars(fewer).update(vars(self), threads=max(1, threads))
        return fewer

    def share(self, kernel: Callable[..., Any], count: int, *arguments: Any) -> None:
        """Call ``kernel(begin, end, *arguments)`` for parts of ``range(count)``, one a thread.

        What the kernel writes must not depend on how the range is parted.
        """
        if self._others is None or self.threads == 1 or os.getpid() != self._process:
            kernel(0, count, *arguments)
            return
        edges = [count * part // self.threads for part in range(self.threads + 1)]
        others = [
            self._others.submit(kernel, begin, end, *arguments)
            for begin, end in pairwise(edges[1:])
        ]
        kernel(0, edges[1], *arguments)
        for other in others:
            other.result()
