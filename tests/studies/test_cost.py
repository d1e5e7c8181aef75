"""Predicted cost of a study: reported, stored, and used."""

import pytest

import multicell as mc
from multicell.report.explain.cost import predict
from multicell.results.documents import read_document
from multicell.studies.cost import EXPECTED_FILE, Cost, cost_of, costs_of, total_cost
from multicell.studies.plan import make_plan

EMT6 = mc.load_scene("emt6")


def test_it_is_what_explain_tells_of_each_run():
    expected = predict(EMT6)
    assert cost_of(EMT6) == Cost(expected.seconds, expected.memory, expected.file)


def test_runs_together_share_cores():
    costs = [Cost(60.0, 3e8, 1e6), Cost(30.0, 2e8, 2e6), Cost(10.0, 1e8, 3e6)]
    one, two, many = (total_cost(costs, cores) for cores in (1, 2, 9))
    assert (one.runs, one.core_seconds, one.seconds) == (3, 100.0, 100.0)
    assert (two.seconds, many.seconds) == (60.0, 60.0)  # the longest decides
    assert [c.memory for c in (one, two, many)] == [3e8, 5e8, 6e8]
    assert [c.disk for c in (one, two, many)] == [6e6] * 3
    assert total_cost([], 4).seconds == 0.0


def test_it_is_found_once(tmp_path, monkeypatch):
    plan = make_plan(EMT6, {"duration": "1,2 d"}, seeds=3)
    found = costs_of(plan, tmp_path)
    assert len(found) == 2
    assert found[1].seconds > found[0].seconds
    monkeypatch.setattr("multicell.studies.cost.cost_of", None)
    assert costs_of(plan, tmp_path) == found
    monkeypatch.undo()
    (tmp_path / EXPECTED_FILE).write_text("damaged")
    assert costs_of(plan, tmp_path) == found
    assert len(read_document(tmp_path / EXPECTED_FILE)) == 2


def test_a_study_tells_what_is_left(tmp_path):
    study = mc.study(EMT6, {"duration": "1,2 d"}, seeds=3, output=tmp_path / "study")
    cost = study.expected(2)
    assert cost.runs == 6
    assert cost.core_seconds == pytest.approx(sum(run.expected for run in study.runs))
