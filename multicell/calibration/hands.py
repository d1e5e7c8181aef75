"""Who does the work of a fit: this process, or the workers of a Dask cluster.

Both are used alike: work is handed out, and whatever is done comes back, in any order.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Protocol, final

from multicell.errors import FitFailed


class Hands(Protocol):
    """Where functions are called."""

    @property
    def count(self) -> int:
        """How many calls can go on at the same time."""
        ...

    def give(self, key: Any, function: Callable[..., Any], *arguments: Any) -> None:
        """Hand out a call; ``key`` is what its result will come back with."""
        ...

    def take(self) -> tuple[Any, Any]:
        """Wait for a call to be done; return its key and its result.

        Raises
        ------
        FitFailed
            If the process that called died time after time.
        """
        ...

    @property
    def busy(self) -> int:
        """How many calls have been handed out and not taken back."""
        ...

    def drop(self) -> None:
        """Forget all calls that have not been taken back."""
        ...


@final
class OwnHands:
    """The process itself: a call is made when its result is asked for."""

    def __init__(self) -> None:
        self._waiting: list[tuple[Any, Callable[..., Any], tuple[Any, ...]]] = []
        self.count = 1

    def give(self, key: Any, function: Callable[..., Any], *arguments: Any) -> None:
        """Note a call."""
        self._waiting.append((key, function, arguments))

    def take(self) -> tuple[Any, Any]:
        """Make the call that was noted first."""
        key, function, arguments = self._waiting.pop(0)
        return key, function(*arguments)

    @property
    def busy(self) -> int:
        """How many calls are noted."""
        return len(self._waiting)

    def drop(self) -> None:
        """Forget all calls."""
        self._waiting.clear()


@final
class ClusterHands:
    """The workers of a Dask cluster; calls of a worker that is lost are made by another."""

    def __init__(self, client: Any) -> None:
        self._client = client
        self._keys: dict[Any, Any] = {}
        self._done = _completed(self._client)

    @property
    def count(self) -> int:
        """Threads of all workers: one a process, as :func:`workers` starts them."""
        threads: int = sum(self._client.nthreads().values())
        return max(1, threads)

    def give(self, key: Any, function: Callable[..., Any], *arguments: Any) -> None:
        """Submit a call."""
        # equal calls are different work: what is computed depends on nothing but the arguments,
        # but a call that was dropped must not come back as another one
        future = self._client.submit(function, *arguments, pure=False)
        self._keys[future] = key
        self._done.add(future)

    def take(self) -> tuple[Any, Any]:
        """Wait for any call."""
        from distributed import KilledWorker

        future = next(self._done)
        key = self._keys.pop(future)
        try:
            return key, future.result()
        except KilledWorker as error:
            raise FitFailed(
                f"a run ends the process that makes it, time after time ({error})",
                "It may need more memory than there is: see 'multicell explain'.",
            ) from error

    @property
    def busy(self) -> int:
        """How many calls are with the cluster."""
        return len(self._keys)

    def drop(self) -> None:
        """Cancel all calls."""
        self._client.cancel(list(self._keys))
        self._keys.clear()
        self._done = _completed(self._client)


def _completed(client: Any) -> Any:
    """Return an empty iterator over calls in the order in which they end."""
    from distributed import as_completed

    made: Any = as_completed
    return made(loop=client.loop, with_results=False)


@contextmanager
def hands(cores: int | None, scheduler: str | None) -> Iterator[Hands]:
    """Yield who works: with one core and no scheduler this process, else a Dask cluster.

    Parameters
    ----------
    cores
        Number of worker processes on this machine; None: as many as it has cores.
    scheduler
        Address of a Dask scheduler whose workers are used instead.
    """
    if cores == 1 and scheduler is None:
        yield OwnHands()
        return
    from multicell.studies.workers import workers

    with workers(cores, scheduler) as client:
        working = ClusterHands(client)
        try:
            yield working
        finally:
            working.drop()
