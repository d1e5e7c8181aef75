"""Methods without mechanics, and the motion that they leave, against closed forms."""

import numpy as np
import pytest

from multicell.comparison.ladders import find_method
from multicell.comparison.null_methods import RESOLUTION, MotionScale, residual_motion
from multicell.comparison.record import record
from multicell.comparison.replay import replay
from multicell.integrators.registry import METHODS
from multicell.scene.scene import load_scene

RNG = np.random.default_rng(7)


@pytest.fixture(scope="module")
def growing():
    """Return two coupling steps of a growing cluster, each from its recorded state."""
    scene = load_scene("grow-2000").with_changes({"initial.count": 30, "duration": "30 min"})
    leading = find_method("rkc2", scene, 5.0).make(1e-3)
    return record(scene, leading, 2, threads=1)[0]


def test_nothing_is_left_of_a_translation_with_a_dilation():
    start = RNG.normal(size=(50, 3))
    assert np.allclose(residual_motion(start, 1.1 * start + [3.0, -2.0, 1.0]), 0.0, atol=1e-13)


def test_the_best_dilation_is_that_of_a_least_squares_fit():
    start = RNG.normal(size=(50, 3))
    end = 1.02 * start + 0.1 * RNG.normal(size=(50, 3))
    # four unknowns: a scale and a translation
    matrix = np.column_stack([start.ravel(), np.tile(np.eye(3), (50, 1))])
    fitted = matrix @ np.linalg.lstsq(matrix, end.ravel(), rcond=None)[0]
    assert np.allclose(residual_motion(start, end), end - fitted.reshape(50, 3), atol=1e-12)


def test_errors_are_relative_to_what_dilation_leaves():
    start = RNG.normal(size=(40, 3))
    end = start.copy()
    end[::2, 0] += 2.0
    end[1::2, 0] -= 2.0
    scale = MotionScale.of(start, end, 5.0)
    # the best scale is 1 + s with s = Σ x·u / Σ x²
    before, moved = start - start.mean(axis=0), end - start
    left = moved - moved.mean(axis=0) - np.sum(before * moved) / np.sum(before**2) * before
    assert scale.rms == pytest.approx(np.sqrt(np.mean(np.sum(left**2, axis=1))))
    off = end.copy()
    off[3, 1] += 0.3
    error, worst = scale.errors(off, end)
    assert error == pytest.approx(0.3 / np.sqrt(40) / scale.rms)
    assert worst == pytest.approx(0.3 / scale.largest)


def test_nothing_is_relative_to_motions_that_do_not_count():
    start = RNG.normal(size=(40, 3))
    scale = MotionScale.of(start, 1.001 * start, 5.0)
    assert (scale.rms, scale.largest) == (5.0 * RESOLUTION, 5.0 * RESOLUTION)
    assert scale.residual == pytest.approx(0.0, abs=1e-15)


def test_cells_stand_still(growing):
    found = replay(growing, find_method("stand-still", growing.scene, 5.0).make(np.nan))
    assert all(map(np.array_equal, found.positions, growing.starts))


def test_dilation_follows_the_volume(growing):
    found = replay(growing, find_method("dilation", growing.scene, 5.0).make(np.nan))
    for step, start, end in zip(growing.steps, growing.starts, found.positions, strict=True):
        volumes = [np.sum(r**3) for r in (step.motion.radius, step.motion.end_radius)]
        assert np.allclose(end.mean(axis=0), start.mean(axis=0))
        spread = [np.sum((x - x.mean(axis=0)) ** 2) for x in (start, end)]
        assert (spread[1] / spread[0]) ** 1.5 == pytest.approx(volumes[1] / volumes[0])


def test_no_scene_runs_with_a_null_method():
    assert not {"stand-still", "dilation"} & set(METHODS)
