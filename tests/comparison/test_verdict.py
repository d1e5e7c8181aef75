"""The sentence with the verdict of a comparison, and what its axes say."""

import pytest
from two_cells import result_of

from multicell.comparison.page import comparison_context

EXPLICIT, IMPLICIT = "ab2-adaptive", "cvode"


def test_the_best_is_compared_with_the_best_of_the_other_kind():
    result = result_of(
        [
            (EXPLICIT, 1.0, 0.005),
            ("rkc2", 1.5, 0.005),
            (IMPLICIT, 3.1, 0.005),
            ("rosenbrock", 9.0, 0.001),
        ]
    )
    assert result.verdict() == "At 1 %: ab2-adaptive, 3.1 times cheaper than cvode."
    swapped = result_of(
        [(EXPLICIT, 4.0, 0.005), (IMPLICIT, 2.0, 0.005), ("rosenbrock", 2.5, 0.005)]
    )
    assert swapped.verdict() == "At 1 %: cvode, 2 times cheaper than ab2-adaptive."


def test_a_kind_that_does_not_reach_the_error_is_named():
    result = result_of([(EXPLICIT, 1.0, 0.005), ("rkc2", 1.5, 0.005), (IMPLICIT, 3.1, 0.5)])
    words = (
        "At 1 %: ab2-adaptive, 1.5 times cheaper than rkc2; no implicit method reaches this error."
    )
    assert result.verdict() == words
    assert result.verdict(0.6) == "At 60 %: ab2-adaptive, 3.1 times cheaper than cvode."


@pytest.mark.parametrize(
    ("solves", "words"),
    [
        ([(EXPLICIT, 1.0, 0.5)], "At 1 %: no method reaches this error."),
        ([(EXPLICIT, 1.0, 0.005)], "At 1 %: ab2-adaptive."),
        (
            [(EXPLICIT, 1.0, 0.005), ("rkc2", 1.02, 0.005)],
            "At 1 %: ab2-adaptive, no cheaper than rkc2.",
        ),
        (
            [(EXPLICIT, 1.0, 0.005), ("scipy-bdf", 0.1, 0.005)],
            "no implicit method reaches this error",
        ),
        (
            [("mine.py:Own", 1.0, 0.005), (EXPLICIT, 2.0, 0.005)],
            "mine.py:Own, 2 times cheaper than ab2",
        ),
    ],
)
def test_one_none_and_methods_from_outside(solves, words):
    assert words in result_of(solves).verdict()


def test_page_and_axes_name_the_error():
    result = result_of([(EXPLICIT, 1.0, 0.005), (EXPLICIT, 9.0, 1e-4), (IMPLICIT, 3.1, 0.005)])
    shown = comparison_context(result)
    assert shown["verdict"].startswith(result.verdict())
    assert "At 0.1 %" in shown["verdict"]
    labels = [axes.get_ylabel() for axes in result.figure().axes]
    named = [" ".join(label.split()) for label in labels if label.startswith("error")]
    words = "error: root mean square distance of the cells from the reference / mean radius"
    assert named == [words]
