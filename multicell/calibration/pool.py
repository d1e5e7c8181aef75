"""Where the runs of a fit are made: in this process, or by the workers of a Dask cluster.

Both are executors of :mod:`concurrent.futures`.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import CancelledError, Executor, Future
from contextlib import contextmanager
from queue import SimpleQueue
from typing import Any, Final, final

from multicell.errors import ClusterError, FitFailed

_AHEAD: Final = 2
"""Calls that are submitted for each worker, so that none of them waits for the next one."""

Call = tuple[Any, Callable[..., Any], tuple[Any, ...]]
"""What a result comes back with, the function, and its arguments."""


class InProcessExecutor(Executor):
    """Makes each call in this process, as soon as it is submitted."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Make a call and return its result as a future; what it raises is raised at once."""
        future: Future[Any] = Future()
        future.set_result(fn(*args, **kwargs))
        return future


@final
class Pool:
    """An executor, and how many calls it makes at the same time.

    - ``executor``: makes the calls; by default this process
    - ``threads``: counts the workers, which may come and go; by default there is one
    """

    def __init__(
        self, executor: Executor | None = None, threads: Callable[[], int] | None = None
    ) -> None:
        self._executor = InProcessExecutor() if executor is None else executor
        self._threads = threads

    @property
    def count(self) -> int:
        """How many calls are made at the same time."""
        return 1 if self._threads is None else max(1, self._threads())

    def results(self, calls: Iterable[Call]) -> Generator[tuple[Any, Any], None, None]:
        """Make calls and yield the key and the result of each one, in the order in which they end.

        Calls are taken one by one as workers come free, so that their iterator may depend on the
        results so far. Those under way are cancelled where this iterator is closed.
        """
        ended: SimpleQueue[Future[Any]] = SimpleQueue()
        pending: dict[Future[Any], Any] = {}
        remaining = iter(calls)
        try:
            while True:
                # in this process a call has ended once it is submitted: none is made in vain
                most = 1 if self._threads is None else _AHEAD * self.count
                while len(pending) < most and (call := next(remaining, None)) is not None:
                    key, function, arguments = call
                    future = self._executor.submit(function, *arguments)
                    pending[future] = key
                    future.add_done_callback(ended.put)
                if not pending:
                    return
                future = ended.get()
                yield pending.pop(future), _result(future)
        finally:
            for future in pending:
                future.cancel()


def _result(future: Future[Any]) -> Any:
    """Return what a call came to, or say why it came to nothing."""
    try:
        return future.result()
    except CancelledError as error:
        raise ClusterError(
            "the scheduler has gone",
            "All runs that have ended are kept: the same fit continues with them",
            exit_code=1,
        ) from error
    except Exception as error:
        if type(error).__name__ != "KilledWorker":  # of Dask, which need not be installed
            raise
        raise FitFailed(
            f"a run ends the process that makes it, time after time ({error})",
            "It may need more memory than there is: see 'multicell explain'.",
        ) from error


@contextmanager
def open_pool(cores: int | None, scheduler: str | None) -> Iterator[Pool]:
    """Yield a pool: with one core and no scheduler this process, else workers of Dask.

    - ``cores``: number of worker processes on this machine; None: as many as it has cores
    - ``scheduler``: address of a Dask scheduler whose workers are used instead
    """
    if cores == 1 and scheduler is None:
        yield Pool()
        return
    from multicell.studies.workers import workers

    client: Any  # Dask's has no types
    with workers(cores, scheduler) as client:
        # equal calls are different work: one that was cancelled must not come back as another
        executor = client.get_executor(pure=False)
        yield Pool(executor, lambda: sum(client.nthreads().values()))
