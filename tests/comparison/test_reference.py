"""The reference: its own uncertainty, and when what is on disk is used again."""

from dataclasses import dataclass, fields

import numpy as np
import pytest
from synthetic import cells_at
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
from multicell.comparison import cache
from multicell.comparison.reference import method_pair, reference
from multicell.comparison.replay import replay
from multicell.integrators.runge_kutta import Euler
from multicell.scene.scene import load_scene

# the reference


def test_the_reference_meets_the_closed_form_and_its_own_uncertainty():
    found = reference(PAIR, cache=False)
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
    found = reference(PAIR, cache=False, progress=told.append)
    assert found.words == "exact at 2, checked by exact at 1"
    assert any("planted end" in line for line in told)


# cache


@pytest.fixture
def counted(tmp_path):
    """Return a function that gets the reference of a scene, and a list of solved steps."""
    calls = []

    @dataclass(frozen=True)
    class Counted:
        def integrate(self, system, position):
            calls.append(system.motion.end)
            return Planted().integrate(system, position)

    method = step_method(lambda _: Counted(), "counted")

    def get(scene=PAIR, setting=1.0, **options):
        pair = ((method, setting), (method, 1.0))
        return reference(scene, pair=pair, cache=tmp_path / "cache", **options)

    return get, calls


def test_a_cached_reference_is_used_again(counted):
    get, calls = counted
    first = get()
    assert (len(calls), first.cached) == (10, False)
    second = get()
    assert (len(calls), second.cached) == (10, True)
    assert second.uncertainty == first.uncertainty
    assert second.words == first.words
    for name in ("energy", "gyration", "distances"):
        np.testing.assert_array_equal(getattr(second.observed, name), getattr(first.observed, name))
    assert second.wall == first.wall
    # output and integrator of the scene have no part in a reference
    get(PAIR.with_changes({"output.every": "1 min", "integrator.rtol": 1e-3}))
    assert len(calls) == 10


@pytest.mark.parametrize(
    "change",
    ["scene", "source", "version", "pair", "cells", "damage"],
)
def test_a_cached_reference_is_not_used_when_anything_changed(
    counted, monkeypatch, tmp_path, change
):
    get, calls = counted
    get()
    options, scene = {}, PAIR
    if change == "scene":
        scene = PAIR.with_changes({"drag.viscosity": 4.0})
    elif change == "source":
        monkeypatch.setattr(cache, "source_hash", lambda: "another")
    elif change == "version":
        monkeypatch.setattr(cache, "versions", lambda: {"multicell": "9.9"})
    elif change == "pair":
        options["setting"] = 2.0
    elif change == "cells":
        options["cells"] = cells_at([[0.0, 0, 0], [7.0, 0, 0]], radius=RADIUS)
    else:
        (file,) = (tmp_path / "cache").glob("*.npz")
        file.write_bytes(file.read_bytes()[:200])
    assert not get(scene, **options).cached
    assert len(calls) == 20


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
    *_, last = references.default_pairs(scene, references.unsolved_problem(scene, None, 1))
    assert [(method.name, setting) for method, setting in last] == [
        ("cvode", tolerance),
        ("cvode", 10.0 * tolerance),
    ]


def test_methods_of_two_families_check_each_other():
    def best(scene, stepwise=None):
        return references.default_pairs(
            scene, references.unsolved_problem(scene, None, 1), stepwise
        )[0]

    assert [(method.name, setting) for method, setting in best(PAIR)] == [
        ("scipy-dop853", 1e-12),
        ("cvode", 1e-12),
    ]
    many = load_scene("settle").with_changes({"initial.count": 2500})
    assert [method.name for method, _ in best(many)] == ["scipy-dop853", "dopri5"]
    single = best(GROWING, 24)
    assert [method.name for method, _ in single] == ["dopri5", "cvode"]
    assert all(setting <= 1e-10 for _, setting in single)


def test_the_source_hash_follows_what_changes_numbers_and_not_the_pictures(tmp_path):
    names = ("cells.py", "mechanics/forces.py", "report/page.py", "comparison/charts.py")
    for name in names:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("a = 1\n")
    seen = [cache.source_hash(tmp_path)]
    for name in names:
        (tmp_path / name).write_text("a = 2\n")
        seen.append(cache.source_hash(tmp_path))
    assert len({*seen[:3]}) == 3
    assert seen[2] == seen[3] == seen[4]


def test_the_cache_folder_can_be_chosen(monkeypatch, tmp_path):
    monkeypatch.setenv("MULTICELL_CACHE", str(tmp_path))
    assert cache.cache_folder() == tmp_path
    monkeypatch.delenv("MULTICELL_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache.cache_folder() == tmp_path / "multicell" / "references"


SORTING = GROWING.with_changes(
    {
        "duration": "4 h",
        "contact.law": "exact-jkr",
        "types.a": {"fraction": 0.5},
        "types.b": {"fraction": 0.5, "young": "3 kPa"},
    }
)


def test_events_pairs_and_types_of_a_growing_problem_survive_the_cache(tmp_path):
    pair = method_pair([("euler", 5.0), ("euler", 10.0)], SORTING, 4.0)
    first, second = (reference(SORTING, pair=pair, cache=tmp_path) for _ in range(2))
    assert (first.cached, second.cached) == (False, True)
    assert any(step.before is not None for step in first.problem.steps)
    for one, two in zip(first.problem.steps, second.problem.steps, strict=True):
        assert (one.before is None) == (two.before is None)
        for spec in fields(one.motion):
            known, read = (getattr(step.motion, spec.name) for step in (one, two))
            np.testing.assert_array_equal(known, read)
            assert getattr(known, "dtype", None) == getattr(read, "dtype", None)
        assert one.motion.touching is not None
        assert one.motion.kind is not None
    assert second.observed.energy == pytest.approx(first.observed.energy, rel=1e-14)
    ends = [replay(r.problem, Euler(10.0)).positions[-1] for r in (first, second)]
    np.testing.assert_array_equal(ends[0], ends[1])
