"""The reference: its own uncertainty, and the methods that give it."""

import numpy as np
import pytest
from two_cells import (
    EXACT,
    GROWING,
    PAIR,
    RADIUS,
    Planted,
    apart_after,
    compared,
    step_method,
)

import multicell.comparison.reference as references
from multicell import StepFailed
from multicell.comparison.reference import reference
from multicell.scene.scene import load_scene

# the reference


def test_the_reference_meets_the_closed_form_and_its_own_uncertainty():
    found = reference(PAIR)
    exact = [np.linalg.norm(p[1] - p[0]) for p in found.trajectory.positions]
    np.testing.assert_allclose(exact, apart_after(found.problem.times), atol=1e-9 * RADIUS)
    assert 0.0 < found.uncertainty["position"] < 1e-9


@pytest.mark.parametrize("planted", [1e-2, 1e-6])
def test_a_planted_uncertainty_is_measured_and_withheld_from_the_verdict(planted):
    checked = step_method(lambda s: Planted(shift=planted * RADIUS), "off")
    result = compared([EXACT], [1.0], references=[(EXACT, 1.0), (checked, 1.0)])
    assert result.uncertainty["position"] == pytest.approx(planted, rel=1e-8)
    assert result.uncertainty["gyration"] == pytest.approx(0.0, abs=1e-12)
    # the method is exact, but that cannot be known better than the reference is
    assert result.table[0]["error_position"] == 0.0
    assert result.fastest(1.1 * planted)["method"] == "exact"
    assert result.fastest(0.9 * planted) is None


def test_a_reference_that_cannot_be_computed_says_so():
    failing = step_method(lambda s: Planted(fail_after=130.0), "stuck")
    with pytest.raises(StepFailed, match="planted end"):
        compared([EXACT], [1.0], references=[(failing, 1.0), (EXACT, 1.0)])
    with pytest.raises(StepFailed, match="check of the reference by stuck failed"):
        compared([EXACT], [1.0], references=[(EXACT, 1.0), (failing, 1.0)])


def test_the_next_pair_is_tried_where_the_best_one_cannot_hold_the_scene(monkeypatch):
    failing = step_method(lambda s: Planted(fail_after=0.0), "stuck")
    pairs = [((failing, 1.0), (EXACT, 1.0)), ((EXACT, 2.0), (EXACT, 1.0))]
    monkeypatch.setattr(references, "default_pairs", lambda *_: pairs)
    told = []
    found = reference(PAIR, progress=told.append)
    assert found.words == "exact at 2, checked by exact at 1"
    assert any("planted end" in line for line in told)


@pytest.mark.parametrize(
    ("name", "changes", "tolerance"),
    [
        ("settle", {"initial.count": 5000}, 1e-9),
        ("growth", {"stop_cells": 300}, 1e-12),
        ("growth", {"stop_cells": 3000, "initial.count": 20}, 1e-9),
        ("growth", {"duration": "2 d"}, 1e-12),
    ],
)
def test_cvode_as_reference_is_as_tight_as_the_scene_allows(name, changes, tolerance):
    scene = load_scene(name).with_changes(changes)
    *_, last = references.default_pairs(scene, references.unsolved_problem(scene, 1))
    assert [(method.name, setting) for method, setting in last] == [
        ("cvode", tolerance),
        ("cvode", 10.0 * tolerance),
    ]


def test_methods_of_two_families_check_each_other():
    def best(scene, stepwise=None):
        return references.default_pairs(scene, references.unsolved_problem(scene, 1), stepwise)[0]

    assert [(method.name, setting) for method, setting in best(PAIR)] == [
        ("scipy-dop853", 1e-12),
        ("cvode", 1e-12),
    ]
    many = load_scene("settle").with_changes({"initial.count": 2500})
    assert [method.name for method, _ in best(many)] == ["scipy-dop853", "dopri5"]
    single = best(GROWING, 24)
    assert [method.name for method, _ in single] == ["dopri5", "cvode"]
    assert all(setting <= 1e-10 for _, setting in single)
