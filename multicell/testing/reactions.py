"""Promises of reactions between fields."""

from __future__ import annotations

from typing import Any

import numpy as np


def check_reaction(reaction: Any) -> None:
    """Check a reaction; raise ``AssertionError`` with every requirement that it violates.

    At points over six decades of concentrations up to its ``upto``, and where one of its fields or
    all are absent:

    - rates are finite, and so is their derivative, given or found by differences;
    - no field is consumed where there is none of it;
    - the derivative, integrated along lines, is the change of the rates;
    - compiled it has the rates of the Python function.

    Parameters
    ----------
    reaction
        Made by :func:`multicell.reaction`.
    """
    from multicell.nutrient.reactions.check import problems
    from multicell.nutrient.reactions.own import OwnReaction
    from multicell.nutrient.reactions.own_kernels import Cell

    if not isinstance(reaction, OwnReaction):
        raise AssertionError(f"{reaction!r} is not made by multicell.reaction")
    name = getattr(reaction.rate, "__name__", "the reaction")
    found = problems(reaction)
    if found:
        raise AssertionError(f"{name} {' '.join(found)}")
    rng = np.random.default_rng(3)
    for _ in range(20):
        c, tissue = reaction.upto * rng.random(len(reaction.fields)), float(rng.random())
        compiled = reaction.evaluate(c[:, None], np.array([tissue]))[0][:, 0]
        plain = reaction([float(x) for x in c], Cell(tissue))
        if not np.allclose(compiled, plain, rtol=1e-9, atol=0.0):
            raise AssertionError(f"{name}, compiled, has the rates {compiled} at {c}, not {plain}")


class ReactionTests:
    """Tests of a reaction between fields; a subclass gives it by a fixture of pytest.

    ::

        class TestBinding(ReactionTests):
            @pytest.fixture
            def reaction(self):
                return binding
    """

    def test_reaction_keeps_its_promises(self, reaction: Any) -> None:
        """All of :func:`check_reaction`."""
        check_reaction(reaction)

    def test_it_gives_the_same_bits_again(self, reaction: Any) -> None:
        """Rates are the same if asked twice, and concentrations are left as they were."""
        c = reaction.upto * np.random.default_rng(4).random((len(reaction.fields), 5))
        before, tissue = c.copy(), np.linspace(0.0, 1.0, 5)
        first, again = (np.array(reaction.evaluate(c, tissue)[0]) for _ in range(2))
        np.testing.assert_array_equal(again, first)
        np.testing.assert_array_equal(c, before)
