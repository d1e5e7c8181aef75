"""The tolerance is held by single cells, not only in the mean over thousands."""

import functools

import numpy as np
import pytest
from formulas import end_of
from oracles import reference, smooth_scene
from strategies import mechanics

from multicell.contact.jkr import JKR
from multicell.integrators.auto import Auto
from multicell.integrators.cvode import Cvode, CvodeAdams
from multicell.integrators.restarts import Run

VISCOSITY, DURATION = 0.05, 60.0
SEEDS = range(3)


def divided(n, seed, share=0.1):
    """Return centres and radii of a settled ball in which some cells have just divided."""
    rng = np.random.default_rng(seed)
    lattice = np.stack(np.meshgrid(*3 * [np.arange(-5.0, 6.0)]), axis=-1).reshape(-1, 3)
    position = 7.6 * lattice[np.argsort((lattice**2).sum(axis=1), kind="stable")[:n]]
    position += rng.normal(0.0, 0.3, position.shape)
    radius = np.full(n, 4.5)
    settled = mechanics(radius, np.ones(n), duration=3600.0)
    position = Auto(1e-6, 1e-3).integrate(settled, position).position
    mothers = rng.choice(n, max(1, int(share * n)), replace=False)
    daughter = 4.5 * 2.0 ** (-1.0 / 3.0)
    axis = rng.normal(size=(len(mothers), 3))
    apart = 0.5 * daughter * axis / np.linalg.norm(axis, axis=1)[:, None]
    position = np.concatenate([position, position[mothers] - apart])
    position[mothers] += apart
    radius[mothers] = daughter
    return position, np.concatenate([radius, np.full(len(mothers), daughter)])


def system(radius):
    return mechanics(radius, np.ones(len(radius)), duration=DURATION, viscosity=VISCOSITY)


def accepted_steps(monkeypatch):
    """Return a list to which each step adds begin, start, end, stop and its estimated error."""
    taken, step = [], Run._step

    class Noted:
        def __init__(self, solver):
            self.solver = solver

        def step(self):
            reached, position, self.error = self.solver.step()
            return reached, position, self.error

    def noted(run, solver):
        before = run.elapsed, run.position.copy()
        watched = Noted(solver)
        length = step(run, watched)
        taken.append((*before, run.elapsed, run.position.copy(), watched.error))
        return length

    monkeypatch.setattr(Run, "_step", noted)
    return taken


@pytest.mark.parametrize(("method", "n"), [(Cvode, 300), (Cvode, 1300), (CvodeAdams, 1300)])
def test_no_step_is_accepted_in_which_one_cell_is_wrong_by_many_tolerances(method, n, monkeypatch):
    taken = accepted_steps(monkeypatch)
    position, radius = divided(n, 1, share=0.004)
    used = system(radius)
    outcome = method(atol=1e-2).integrate(used, position)
    assert outcome.done
    assert np.nanmax([step[4] for step in taken]) <= 1e-2 + 1e-6 * 5.0


def test_the_norm_of_sundials_lets_a_cell_be_wrong_by_many_tolerances(monkeypatch):
    taken = accepted_steps(monkeypatch)
    position, radius = divided(300, 1, share=0.004)
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


@functools.cache
def _exact(seed, shift=0.0):
    """Return where DOP853 at 1e-12 leads the cells, from places that may be shifted at random."""
    position, radius = divided(16, seed)
    position = position + shift * np.random.default_rng(seed).normal(size=position.shape)
    young = np.ones(len(radius))
    law = JKR(surface_energy=0.1)
    return end_of(position, radius, young, law, DURATION, viscosity=VISCOSITY)


def _worst(end, seed):
    return np.linalg.norm(end - _exact(seed), axis=1).max()


@pytest.mark.slow
@pytest.mark.parametrize("method", [Cvode(atol=1e-2), Auto(atol=1e-2), Auto(atol=1e-1)])
def test_fresh_daughters_are_no_further_off_than_a_shift_by_the_tolerance_moves_them(method):
    ours, shifted = [], []
    for seed in SEEDS:
        position, radius = divided(16, seed)
        outcome = method.integrate(system(radius), position)
        assert outcome.done
        ours.append(_worst(outcome.position, seed))
        shifted.append(_worst(_exact(seed, method.atol), seed))
    assert np.median(ours) <= 3.0 * np.median(shifted)
