"""Sobol' indices against Ishigami's function, of which they are known, and of a real scene."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from click.testing import CliRunner

import multicell as mc
from multicell.calibration.sensitivity.sobol import sobol_indices, sobol_sample
from multicell.cli.main import main
from multicell.errors import SceneError

NAMES = ["x1", "x2", "x3"]


def ishigami(shares):
    x = math.pi * (2.0 * shares - 1.0)
    return np.sin(x[:, 0]) + 7.0 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])


def exact():
    """First and total indices for a = 7, b = 0.1 (Ishigami & Homma 1990)."""
    v1 = 0.5 * (1.0 + 0.1 * math.pi**4 / 5.0) ** 2
    v2, v13 = 49.0 / 8.0, 0.01 * math.pi**8 * 8.0 / 225.0
    whole = v1 + v2 + v13
    return np.array([v1, v2, 0.0]) / whole, np.array([v1 + v13, v2, v13]) / whole


def test_the_indices_of_ishigami_are_within_their_intervals():
    shares = sobol_sample(NAMES, 4096)
    found, used = sobol_indices(NAMES, ishigami(shares)[:, None])
    assert used == 4096
    for column, truth in zip(("S1", "ST"), exact(), strict=True):
        assert (np.abs(found[column] - truth) <= found[f"{column}_conf"] + 1e-3).all()
        assert found[column] == pytest.approx(truth, abs=0.02)
    assert np.isnan(found["noise"]).all()


def test_noise_over_seeds_is_its_part_of_the_variance():
    shares = sobol_sample(NAMES, 1024)
    values = ishigami(shares)
    deviation = 2.0 * values.std()
    scatter = np.random.default_rng(1).standard_normal((len(values), 4)) * deviation
    found, _ = sobol_indices(NAMES, values[:, None] + scatter)
    assert found["noise"] == pytest.approx(1.0 / (1.0 + 4.0 / 4.0), abs=0.03)  # of 4 seeds


def test_what_is_missing_or_constant_has_no_index():
    values = ishigami(sobol_sample(NAMES, 64))[:, None]
    values[7] = np.nan
    found, used = sobol_indices(NAMES, values)
    assert used == 63
    assert np.isfinite(found["ST"]).all()
    found, _ = sobol_indices(NAMES, np.full_like(values, 3.0))
    assert np.isnan(found["ST"]).all()
    with pytest.raises(SceneError, match=r"must be a power of two, at least 8\. Take 64"):
        sobol_sample(NAMES, 50)


@pytest.mark.slow
def test_the_command_finds_what_decides_a_scene(tmp_path):
    options = ["--set", "duration=2 h", "--set", "initial.count=4", "--set", "coupling_step=1 h"]
    free = ["--free", "cells.division_radius=4:8 um", "--free", "drag.viscosity=1:2 kPa s"]
    done = CliRunner().invoke(
        main,
        ["sensitivity", "growth", *options, *free, "--method", "sobol", "--size", "16", "-o",
         str(tmp_path), "--observable", "diameter", "--cores", "1", "--json", "--yes"],
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    written = json.loads((tmp_path / "sensitivity.json").read_text(encoding="utf-8"))
    total = {row["parameter"]: row["ST"] for row in written["table"]}
    assert total["division_radius"] > 0.5
    assert abs(total["viscosity"]) < 0.1 * total["division_radius"]
    assert "ST" in (tmp_path / "report.html").read_text(encoding="utf-8")
    with pytest.raises(SceneError, match="method"):
        mc.sensitivity("growth", {"cells.young": "1:2 kPa"}, method="fast")
