"""Promises of laws by which behaviours respond to signals."""

from __future__ import annotations

from typing import Any

import numpy as np

from multicell.behaviours.laws import ResponseLaw
from multicell.cells import FloatArray
from multicell.testing.promises import carry_out_tests, require


def check_response(law: ResponseLaw) -> None:
    """Check a response; raise ``AssertionError`` with every requirement that it violates.

    For signals that rise from 0 to 10:

    - shares are numbers from 0 to 1, one for each cell, in any order of the cells;
    - they are the same if asked twice, and signals are left as they were.

    Parameters
    ----------
    law
        A law with its parameters (:func:`multicell.response`).
    """
    carry_out_tests(ResponseTests(), law, type(law).__name__)


class ResponseTests:
    """Tests of a law of response; a subclass gives the law by a fixture of pytest.

    Each promise of :func:`check_response` is a test of its own::

        class TestHypoxicKill(ResponseTests):
            @pytest.fixture
            def law(self):
                return hypoxic_kill(half=0.002)
    """

    def test_shares_are_from_none_to_all(self, law: ResponseLaw) -> None:
        """Shares are numbers from 0 to 1, one for each cell."""
        found = _share(law, _SIGNAL.copy())
        require(np.shape(found) == _SIGNAL.shape, "it does not return one share for each cell")
        require(np.isfinite(found).all(), "it returns something that is no number")
        require(bool(((found >= 0.0) & (found <= 1.0)).all()), "its shares are not from 0 to 1")

    def test_shares_depend_on_one_cell_alone(self, law: ResponseLaw) -> None:
        """Shares are the same again and in any order of the cells; signals stay as they are."""
        signal = _SIGNAL.copy()
        found = _share(law, signal)
        require(np.array_equal(found, _share(law, signal)), "it does not give the same bits again")
        require(np.array_equal(_SIGNAL, signal), "it writes into its signals")
        back = _share(law, _SIGNAL[::-1].copy())[::-1]
        require(np.array_equal(back, found), "a share depends on the other cells")


_SIGNAL = np.linspace(0.0, 10.0, 201)


def _share(law: ResponseLaw, values: FloatArray) -> FloatArray:
    count = getattr(law, "signals", 1)
    given: Any = (values,) * count if count > 1 else values
    return np.asarray(law.share(given, falls=False))
