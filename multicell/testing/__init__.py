"""Conformance tests for parts of the user's own.

:func:`check_integrator` checks whether a method keeps the promises that runs and comparisons rely
on (:class:`multicell.Integrator`). It fits into any test suite:

>>> from multicell.testing import check_integrator
>>> def test_mine():
...     check_integrator(Midpoint)                                   # doctest: +SKIP

Each kind of part has such a function and a class of tests, one for each promise. A subclass gives
the part by a fixture of pytest, which may have parameters:

>>> import pytest
>>> from multicell.testing import IntegratorTests
>>> class TestMidpoint(IntegratorTests):
...     @pytest.fixture
...     def method(self):
...         return Midpoint                                          # doctest: +SKIP

================ ============================ ============================= ============
part             function                     class of tests                fixture
================ ============================ ============================= ============
contact law      :func:`check_pair_law`       :class:`PairLawTests`         ``law``
growth law       :func:`check_growth_law`     :class:`GrowthLawTests`       ``law``
response         :func:`check_response`       :class:`ResponseTests`        ``law``
method           :func:`check_integrator`     :class:`IntegratorTests`      ``method``
solver of fields :func:`check_field_solver`   :class:`FieldSolverTests`     ``solver``
reaction         :func:`check_reaction`       :class:`ReactionTests`        ``reaction``
network          :func:`check_network`        :class:`NetworkTests`         ``network``
observable       :func:`check_observable`     :class:`ObservableTests`      ``observable``
================ ============================ ============================= ============
"""

from multicell.testing.field_solvers import FieldSolverTests, check_field_solver
from multicell.testing.growth_laws import GrowthLawTests, check_growth_law
from multicell.testing.integrators import (
    TRIED_BEGIN,
    TRIED_END,
    TRIED_STEPS,
    TRIED_TOLERANCES,
    IntegratorTests,
    check_integrator,
)
from multicell.testing.networks import NetworkTests, check_network
from multicell.testing.observables import OBSERVED, ObservableTests, check_observable
from multicell.testing.pair_laws import PairLawTests, check_pair_law
from multicell.testing.reactions import ReactionTests, check_reaction
from multicell.testing.responses import ResponseTests, check_response

__all__ = [
    "OBSERVED",
    "TRIED_BEGIN",
    "TRIED_END",
    "TRIED_STEPS",
    "TRIED_TOLERANCES",
    "FieldSolverTests",
    "GrowthLawTests",
    "IntegratorTests",
    "NetworkTests",
    "ObservableTests",
    "PairLawTests",
    "ReactionTests",
    "ResponseTests",
    "check_field_solver",
    "check_growth_law",
    "check_integrator",
    "check_network",
    "check_observable",
    "check_pair_law",
    "check_reaction",
    "check_response",
]
