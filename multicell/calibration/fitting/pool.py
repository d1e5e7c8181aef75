"""Pools that make the runs of a fit: in this process, or on the workers of a Dask cluster."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError
from contextlib import ExitStack, contextmanager
from functools import cached_property
from typing import Any, final

from multicell.errors import ClusterError, ExitCode, FitFailed

Call = tuple[Any, Callable[..., Any], tuple[Any, ...]]
"""What a result comes back with, the function, and its arguments."""


@final
class Pool:
    """A pool that makes calls: of workers, or in this process.

    - ``connect``: starts workers, when they are first needed, and returns a client of Dask; None:
      this process
    - ``call``: makes one call in this process, of a function and its arguments
    """

    def __init__(
        self,
        connect: Callable[[], Any] | None = None,
        call: Callable[..., Any] = lambda function, *arguments: function(*arguments),
    ) -> None:
        self._connect, self._call = connect, call

    @cached_property
    def _client(self) -> Any:
        return None if self._connect is None else self._connect()

    @property
    def count(self) -> int:
        """How many calls are made at the same time."""
        return 1 if self._client is None else max(1, sum(self._client.nthreads().values()))

    def results(self, calls: Iterable[Call]) -> Iterator[tuple[Any, Any]]:
        """Make calls and yield the key and the result of each one, in the order in which they end.

        In this process each is made once the result before it was taken. Those under way are
        cancelled where this iterator is closed.
        """
        if self._connect is None:
            for key, function, arguments in calls:
                yield key, self._call(function, *arguments)
            return
        calls = list(calls)
        if not calls:  # of a fit that is whole: no worker is started
            return
        import distributed

        from multicell.studies.workers import CheckedClient, Refusal

        as_completed: Any = distributed.as_completed  # which has no types
        client = CheckedClient(self._client)

        def submit(call: Call) -> Any:
            # equal calls are different work: one that was cancelled must not come back as another
            return client.submit(call[1], *call[2], pure=False)

        pending = {submit(call): call for call in calls}
        ended = as_completed(list(pending), loop=self._client.loop)
        try:
            for future in ended:
                call, found = pending.pop(future), future_result(future)
                if isinstance(found, Refusal):
                    client.note(found)
                    again = submit(call)
                    pending[again] = call
                    ended.add(again)
                else:
                    yield call[0], found
        except ClusterError:
            raise
        except BaseException:
            self._client.cancel(list(pending))
            raise


def future_result(future: Any) -> Any:
    """Return the result of a call; raises ClusterError or FitFailed where it has none."""
    try:
        return future.result()
    except CancelledError as error:
        raise ClusterError(
            "the scheduler has gone",
            "All runs that have ended are kept: the same fit continues with them",
            exit_code=ExitCode.MACHINE,
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

    Workers are started by the first calls, if there are any.

    - ``cores``: number of worker processes on this machine; None: as many as it has cores
    - ``scheduler``: address of a Dask scheduler whose workers are used instead
    """
    if cores == 1 and scheduler is None:
        yield Pool()
        return
    from multicell.studies.workers import workers

    with ExitStack() as stack:
        yield Pool(lambda: stack.enter_context(workers(cores, scheduler)))
