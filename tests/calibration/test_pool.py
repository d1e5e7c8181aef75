"""Processes that make the runs of a fit: their order, and reports of lost ones."""

from concurrent.futures import Future
from contextlib import contextmanager

import pytest
from cheap_fits import MATRIX, calls_of, linear

from multicell.calibration.fitting.pool import Pool, future_result, open_pool
from multicell.calibration.fitting.search import Search
from multicell.errors import ClusterError, FitFailed


class KilledWorker(Exception):  # noqa: N818
    """Of the same name as Dask's."""


def calls(count, made):
    for number in range(count):
        made.append(number)
        yield f"call {number}", pow, (number, 2)


def test_in_this_process_a_call_is_made_when_the_one_before_has_ended():
    made, found = [], []
    for key, result in Pool().results(calls(4, made)):
        found.append((key, result))
        assert made == list(range(len(found)))
    assert found == [("call 0", 0), ("call 1", 1), ("call 2", 4), ("call 3", 9)]


def test_no_worker_is_started_for_no_calls(monkeypatch):
    started = []

    @contextmanager
    def count_starts(*given):
        started.append(given)
        yield None

    monkeypatch.setattr("multicell.studies.workers.workers", count_starts)
    with open_pool(2, None) as pool:
        assert list(pool.results([])) == []
        assert started == []
        assert pool.count == 1
    assert started == [(2, None)]


@pytest.mark.slow
def test_workers_find_the_same_as_this_process_to_the_bit():
    problem = linear(MATRIX, [0.4, 0.6, 1.0, -0.2], 0.2, noise=0.1, seeds=2)
    own = Search(problem, None, seed=4).run(Pool(), 15)
    with open_pool(2, None) as pool:
        assert pool.count == 2
        theirs, here = calls_of(lambda: Search(problem, None, seed=4).run(pool, 15))
        equal = sorted(pool.results([(k, pow, (3, 2)) for k in range(5)]))
        left = pool.results([(k, pow, (k, 2)) for k in range(50)])
        key, value = next(left)
        left.close()  # those under way are cancelled
    assert here == []
    assert [e.misfit.loss for e in theirs] == [e.misfit.loss for e in own]
    assert equal == [(k, 9) for k in range(5)]
    assert value == key**2


@pytest.mark.parametrize(
    ("lose", "error", "said"),
    [
        (lambda future: future.cancel(), ClusterError, "the scheduler has gone"),
        (lambda future: future.set_exception(KilledWorker("run")), FitFailed, "time after time"),
        (lambda future: future.set_exception(ZeroDivisionError()), ZeroDivisionError, None),
    ],
)
def test_calls_that_come_to_nothing_say_why(lose, error, said):
    future = Future()
    lose(future)
    with pytest.raises(error, match=said):
        future_result(future)
