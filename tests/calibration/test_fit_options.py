"""Constraints and unknown scatter from the command line to the folder and back."""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner

import multicell as mc
from multicell.calibration.fitting.simulator import Reading, SceneSimulator
from multicell.cli.main import main

KEYS = "nutrients.oxygen.quiescence", "nutrients.oxygen.necrosis"
TIMES = np.arange(1, 11)


def model(shares):
    """Return ten diameters, um, of two parameters that decide level and slope."""
    return 200.0 + 60.0 * shares[0] + 20.0 * TIMES * shares[1]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A fit of closed-form readings by the command, in its folder."""
    place = tmp_path_factory.mktemp("fit")
    noise = 6.0 * np.random.default_rng(3).standard_normal(10)
    rows = zip(TIMES, model((0.6, 0.4)) + noise, strict=True)
    table = "day,diameter / um,diameter sd / um\n" + "".join(f"{t},{d},1.5\n" for t, d in rows)
    (place / "data.csv").write_text(table)
    usual = SceneSimulator.__call__
    SceneSimulator.__call__ = lambda self, shares, condition, seed: Reading(tuple(model(shares)))
    try:
        done = CliRunner().invoke(
            main,
            ["fit", "spheroid", "--data", str(place / "data.csv"), "-o", str(place / "fit"),
             "--free", f"{KEYS[0]}=0.005:0.05 mM", "--free", f"{KEYS[1]}=0.002:0.06 mM",
             "--constraint", "necrosis < quiescence", "--scatter", "unknown", "--seeds", "1",
             "--repeats", "4", "--budget", "40", "--cores", "1", "--yes", "--quiet"],
        )  # fmt: skip
    finally:
        SceneSimulator.__call__ = usual
    assert done.exit_code == 0, done.output
    return place / "fit"


def test_a_fit_with_both_is_opened_from_its_folder(folder):
    found = mc.load_fit(folder)
    summary = json.loads((folder / "result.json").read_text())
    size = found.scatter["diameter"]
    assert summary["scatter"]["diameter"]["best"] == pytest.approx(size.best)
    # that of a straight line through the data, stated as 1.5 um
    data = np.array([datum.value for datum in found.problem.measured.data])
    _, squares, _, _ = np.linalg.lstsq(np.stack([np.ones(10), TIMES], axis=1), data, rcond=None)
    assert size.best == pytest.approx(np.sqrt(squares[0] / 8.0) / 1.5, rel=0.05)
    assert size.low < size.best < size.high
    assert size.words.endswith("µm")
    runs = found.runs
    assert (runs["necrosis"] < runs["quiescence"]).all()
    assert found.problem.prior.constraints.texts() == [f"{KEYS[1]} < {KEYS[0]}"]
    assert found.stated.sigma[0] == pytest.approx(1.5)
    assert found.problem.sigma[0] == pytest.approx(1.5 * size.best)
    assert "scatter_diameter" in (folder / "posterior.csv").read_text().splitlines()[0]


def test_its_page_states_the_size_of_the_errors_and_the_order(folder):
    page = (folder / "report.html").read_text()
    assert "The errors of diameter were fitted" in page
    assert "necrosis &lt; nutrients.oxygen.quiescence" in page


def test_the_same_command_without_them_is_another_fit(folder):
    done = CliRunner().invoke(
        main,
        ["fit", "spheroid", "--data", str(folder.parent / "data.csv"), "-o", str(folder),
         "--free", f"{KEYS[0]}=0.01:0.05 mM", "--free", f"{KEYS[1]}=0.002:0.009 mM",
         "--seeds", "1", "--repeats", "4", "--budget", "40", "--yes", "--quiet"],
    )  # fmt: skip
    assert "holds another fit" in done.output
    assert "scatter" in done.output
    assert "constraints" in done.output


def test_scatter_is_one_of_two_words():
    with pytest.raises(mc.MulticellError, match="scatter"):
        mc.fit("growth", {"time / h": [1.0], "cells": [3.0]}, {}, scatter="some")


def test_checked_ends_stay_in_the_folder_and_are_not_run_again(folder, monkeypatch):
    calls = []

    def called(self, shares, condition, seed):
        calls.append(shares)
        return Reading(tuple(model(shares)))

    monkeypatch.setattr(SceneSimulator, "__call__", called)
    found = mc.load_fit(folder)
    name = next(free.name for free in found.problem.ranges if found.profile(free.name).ends(0.5))
    ends = found.check_profile(name, level=0.5, repeats=4, cores=1)
    assert len(calls) == 4 * len(ends) > 0
    assert mc.load_fit(folder).check_profile(name, level=0.5, repeats=4, cores=1) == ends
    assert len(calls) == 4 * len(ends)
    assert mc.load_fit(folder).best.values == found.best.values
