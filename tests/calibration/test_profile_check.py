"""Ends of profiles run again: confirmed where the emulator is right, denied where it is not."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace

import numpy as np
import pytest
from cheap_fits import MATRIX, Growing, check, exact, fitted, growing, linear
from click.testing import CliRunner
from scipy import stats

from multicell.calibration.fitting.pool import Pool
from multicell.calibration.fitting.profile_check import ProfileEnd, checked_profile
from multicell.calibration.fitting.simulator import Reading
from multicell.cli.main import main
from multicell.errors import SceneError

VALUES = [0.45, 0.62, 1.01, -0.21]


@pytest.fixture(scope="module")
def line():
    return fitted(linear(MATRIX, VALUES, 0.05))


def test_the_ends_of_an_exact_model_have_the_quantile_by_runs_too(line):
    mean, covariance = exact(line.problem)
    for level in (0.8, 0.95):
        ends = checked_profile(line, "p1", level=level, repeats=4, pool=Pool())
        limit = stats.chi2.ppf(level, 1)
        reach = np.sqrt(limit * covariance[1, 1])
        assert [end.value for end in ends] == pytest.approx(
            [mean[1] - reach, mean[1] + reach], abs=2e-3
        )
        for end in ends:
            assert end.loss == pytest.approx(limit, rel=0.05)
            assert end.by_runs == pytest.approx(limit, rel=0.05)
            assert end.error < 1e-6
            assert end.confirmed


@dataclass(frozen=True)
class Other:
    """Readings of a fit's model times a factor, as if the emulator had missed something."""

    inner: object
    factor: float

    def __call__(self, shares, condition, seed):
        found = self.inner(shares, condition, seed)
        return Reading(tuple(self.factor * v for v in found.values))


def test_an_emulator_that_is_wrong_at_an_end_is_denied(line):
    wrong = replace(line.problem, simulator=Other(line.problem.simulator, 1.3))
    ends = checked_profile(replace(line, problem=wrong), "p1", repeats=4, pool=Pool())
    assert not any(end.confirmed for end in ends)


def test_ends_that_data_do_not_bound_are_left_out():
    one = fitted(linear([[1.0, 0.0], [2.0, 0.0]], [0.5, 1.0], 0.05))
    assert checked_profile(one, "p1", pool=Pool()) == []
    assert len(checked_profile(one, "p0", repeats=4, pool=Pool())) == 2


@pytest.mark.slow
def test_runs_that_scatter_are_told_from_an_emulator_that_is_wrong():
    """Over some tissues the difference has the error that is stated, and no bias."""
    rng, away = np.random.default_rng(2), []
    for _ in range(4):
        found = fitted(growing(Growing("shared", noise=4.0), np.array([0.4, 0.5]), rng), points=25)
        for end in checked_profile(found, "p0", repeats=8, pool=Pool()):
            away.append((end.by_runs - end.loss) / end.error)
    assert len(away) == 8
    assert np.abs(away).max() < 4.0
    assert abs(np.mean(away)) < 3.0 / np.sqrt(4.0)


def test_few_runs_are_refused(line):
    with pytest.raises(SceneError, match="repeats: is 2"):
        line.check_profile("p1", repeats=2)


@pytest.mark.slow
def test_the_command_checks_the_ends(line, monkeypatch):
    monkeypatch.setattr("multicell.calibration.fitting.stored.load_fit", lambda folder: line)
    command = ["profile", "fit", "--check", "--repeats", "4", "--cores", "1"]
    said = CliRunner().invoke(main, command)
    assert said.exit_code == 0, said.output
    assert said.output.count("confirmed") == 4
    rows = json.loads(CliRunner().invoke(main, [*command, "--json", "--quiet"]).output)
    assert [len(row["ends"]) for row in rows] == [2, 2]
    assert rows[0]["ends"][0]["confirmed"] is True
    assert ProfileEnd(1.0, 3.84, 9.0, 0.5, 6).confirmed is False


@pytest.mark.slow
def test_intervals_of_profiles_of_a_line_cover_as_often_as_they_say():
    """Twelve data of a straight line with normal errors: 12 repeats, both parameters."""
    rng, hits = np.random.default_rng(6), []
    times = np.linspace(0.0, 1.0, 12)
    matrix = np.stack([1.0 - times, times], axis=1)
    for _ in range(12):
        truth = 0.3 + 0.4 * rng.random(2)
        values = matrix @ truth + 0.1 * rng.standard_normal(12)
        found = fitted(linear(matrix, values, 0.1), points=15)
        profiles = [found.profile(name, 21) for name in ("p0", "p1")]
        hits.append(
            [
                [low <= x <= high for x, (low, high) in
                 zip(truth, (p.interval(level) for p in profiles), strict=True)]
                for level in (0.8, 0.95)
            ]
        )  # fmt: skip
    check(hits)
