"""Where the runs of a fit are made: in which order, how many at once, and what is lost."""

from concurrent.futures import Executor, Future

import pytest

from multicell.calibration.pool import Pool
from multicell.errors import ClusterError, FitFailed


class Held(Executor):
    """Keeps calls until they are let go."""

    def __init__(self):
        self.futures = []

    def submit(self, function, /, *arguments):
        self.futures.append(Future())
        return self.futures[-1]


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


def test_twice_as_many_calls_as_workers_are_under_way_and_those_left_are_cancelled():
    made, executor = [], Held()
    results = Pool(executor, lambda: 2).results(calls(10, made))
    executor.submit = lambda *given: ended(Held.submit(executor, *given), len(executor.futures))
    assert next(results) == ("call 3", "fourth")
    assert len(made) == 4
    results.close()
    assert [future.cancelled() for future in executor.futures] == [True, True, True, False]


def ended(future, number):
    if number == 4:
        future.set_result("fourth")
    return future


@pytest.mark.parametrize(
    ("lose", "error", "said"),
    [
        (lambda future: future.cancel(), ClusterError, "the scheduler has gone"),
        (lambda future: future.set_exception(KilledWorker("run")), FitFailed, "time after time"),
        (lambda future: future.set_exception(ZeroDivisionError()), ZeroDivisionError, None),
    ],
)
def test_calls_that_come_to_nothing_say_why(lose, error, said):
    executor = Held()
    executor.submit = lambda *given: lost(Held.submit(executor, *given), lose)
    with pytest.raises(error, match=said):
        list(Pool(executor, lambda: 1).results(calls(3, [])))


def lost(future, lose):
    lose(future)
    return future
