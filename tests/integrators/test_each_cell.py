"""The tolerance is held by single cells, not only in the mean over thousands."""

import numpy as np
import pytest
from oracles import reference, smooth_scene
from strategies import divided, mechanics

from multicell.integrators.auto import Auto
from multicell.integrators.cvode import Cvode, CvodeAdams
from multicell.integrators.restarts import IntegrationProgress

pytestmark = pytest.mark.kernels


def ball(n):
    """Return centres and radii of a settled ball in which the innermost cell has just divided."""
    lattice = np.stack(np.meshgrid(*3 * [np.arange(-5.0, 6.0)]), axis=-1).reshape(-1, 3)
    position = 7.6 * lattice[np.argsort((lattice**2).sum(axis=1), kind="stable")[:n]]
    position += np.random.default_rng(1).normal(0.0, 0.3, position.shape)
    radius, young = np.full(n, 4.5), np.ones(n)
    settled = mechanics(radius, young, duration=3600.0)
    position = Auto(1e-6, 1e-3).integrate(settled, position).position
    return divided(position, radius, young, np.arange(1), 1)[:2]


def system(radius):
    return mechanics(radius, np.ones(len(radius)), duration=60.0, viscosity=0.05)


def accepted_steps(monkeypatch):
    """Return a list to which each step adds begin, start, end, stop and its estimated error."""
    taken, step = [], IntegrationProgress._step

    class Noted:
        def __init__(self, solver):
            self.solver = solver

        def take_step(self):
            taken = self.solver.take_step()
            self.error = taken.error
            return taken

    def noted(run, solver):
        before = run.elapsed, run.position.copy()
        watched = Noted(solver)
        length = step(run, watched)
        taken.append((*before, run.elapsed, run.position.copy(), watched.error))
        return length

    monkeypatch.setattr(IntegrationProgress, "_step", noted)
    return taken


@pytest.mark.parametrize(("method", "n"), [(Cvode, 300), (Cvode, 1300), (CvodeAdams, 1300)])
def test_no_step_is_accepted_in_which_one_cell_is_wrong_by_many_tolerances(method, n, monkeypatch):
    taken = accepted_steps(monkeypatch)
    position, radius = ball(n)
    used = system(radius)
    outcome = method(atol=1e-2).integrate(used, position)
    assert outcome.done
    assert np.nanmax([step[4] for step in taken]) <= 1e-2 + 1e-6 * 5.0


def test_the_norm_of_sundials_lets_a_cell_be_wrong_by_many_tolerances(monkeypatch):
    taken = accepted_steps(monkeypatch)
    position, radius = ball(300)
    outcome = Cvode(atol=1e-2, each_cell=False).integrate(system(radius), position)
    assert outcome.done
    assert np.nanmax([step[4] for step in taken]) > 10.0 * 1e-2


@pytest.mark.parametrize("light", [True, False])
@pytest.mark.parametrize("atol", [1e-5, 1e-7])
def test_cvode_steps_have_the_errors_that_are_estimated(light, atol, monkeypatch):
    position, make = smooth_scene()
    with monkeypatch.context() as patch:
        taken = accepted_steps(patch)
        assert Cvode(1e-12, atol, light=light).integrate(make(), position).done
    true = []
    for begin, start, end, stop, _ in taken:
        part = make()
        part.motion.begin, part.motion.end = begin, end
        true.append(np.linalg.norm(stop - reference(part, start), axis=1).max())
    assert 0.5 < np.nanmax([step[4] for step in taken]) / max(true) < 3.0
