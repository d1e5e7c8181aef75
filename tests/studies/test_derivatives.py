"""Derivatives by common random numbers, and coarse against fine: closed forms, errors, refusals."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import optimize, stats

import multicell as mc
from multicell.studies import derivatives, engine

CELL = mc.Scene.from_dict({"duration": "10 min", "coupling_step": "5 min", "seed": 4})


pytestmark = pytest.mark.usefixtures("here")


def test_size_of_a_cell():
    """D = 2 R / 2^(1/3) of a newborn cell with the division radius R."""
    row = mc.gradient(CELL, "diameter", "cells.division_radius", seeds=2).rows[0]
    assert row["derivative"] == pytest.approx(2.0 ** (2.0 / 3.0), rel=1e-12)
    assert row["elasticity"] == pytest.approx(1.0, rel=1e-12)
    assert (row["unit"], row["key_unit"]) == ("um", "um")


@pytest.mark.slow
def test_exponential_growth():
    """Of a population that has long grown N = N0 2^(t/T), so d ln N / d ln T = -ln 2 t/T."""
    scene = mc.load_scene("growth").with_changes(
        {"duration": "30 h", "initial.count": 100, "initial.stage": "asynchronous",
         "growth.cycle_time": "15 h", "growth.cycle_variation": 0, "growth.law": "exponential"}
    )  # fmt: skip
    found = mc.gradient(scene, "cells", "growth.cycle_time", seeds=4, times=["15 h", "30 h"])
    for cycles, row in zip((1.0, 2.0), found.rows, strict=True):
        assert row["time"] == cycles * 54000.0
        error = math.hypot(row["elasticity_se"], 0.05)  # of second order in the step, and of steps
        assert row["elasticity"] == pytest.approx(-math.log(2.0) * cycles, abs=2.5 * error)
        assert row["elasticity_se"] < 0.2


STARVED = mc.Scene.from_dict(
    {"duration": "10 min", "coupling_step": "10 min",
     "initial": {"count": 16000, "spacing": 0.9914},
     "cells": {"division_radius": "10 um"}, "drag": {"viscosity": 1e6}, "contact": {"law": "hertz"},
     "death": {"lysis_time": "1000 d"},
     "nutrients": {"oxygen": {
         "diffusion": 2000, "boundary": 0.03, "uptake_per_volume": 0.02, "half_saturation": 1e-5,
         "quiescent_uptake": 1.0, "necrosis": 5e-4, "geometry": "radial", "spacing": 2.5,
         "layer": 1.0}}}
)  # fmt: skip


def rim(boundary, radius, uptake):
    """Return the rim of a ball whose cells die at once where they find less than 5e-4 mM.

    The dead take up nothing, so that the core has 5e-4 mM, and nothing flows into it. Around it
    D c'' + 2 D c' / r = q, so that c(r) = 5e-4 + q/6D (r² - 3 a² + 2 a³/r) outside a core of radius
    a, and a layer of 1 um of medium is around the tissue.
    """

    def missing(a):
        level = 5e-4 + uptake / 12000.0 * (radius**2 - 3.0 * a**2 + 2.0 * a**3 / radius)
        outside = uptake / 6000.0 * (radius**3 - a**3) * (1.0 / radius - 1.0 / (radius + 1.0))
        return level + outside - boundary

    return radius - optimize.brentq(missing, 1e-3, radius)


@pytest.mark.slow
def test_depth_that_oxygen_reaches():
    """To 3 %: the layers in which cells of 10 um lie show in a difference of 43 um."""
    row = mc.gradient(STARVED, "viable_rim", "nutrients.oxygen.boundary", step=0.3, seeds=2).rows[0]
    last = mc.run(STARVED, report=False).history
    radius, uptake = 0.5 * last["diameter"][-1], 0.02 * last["packing_ratio"][-1]
    assert last["viable_rim"][-1] == pytest.approx(rim(0.03, radius, uptake), rel=0.015)
    wanted = (rim(0.039, radius, uptake) - rim(0.021, radius, uptake)) / 0.018
    assert row["derivative"] == pytest.approx(wanted, rel=0.03)


@pytest.mark.slow
def test_scatter_cancels_in_a_spheroid():
    """Different seeds on both sides would take half as many runs more at least."""
    scene = mc.load_scene("spheroid").with_changes(
        {"initial.count": 100, "initial.stage": "asynchronous", "duration": "1 d",
         "nutrients.oxygen.boundary": "0.03 mM"}
    )  # fmt: skip
    row = mc.gradient(scene, "diameter", "nutrients.oxygen.boundary", step=0.1).rows[0]
    assert row["variance_reduction"] > 1.5
    assert row["derivative"] > 5.0 * row["derivative_se"]


@pytest.mark.slow
def test_standard_error_and_variance_reduction(monkeypatch):
    """y = 3 x + shared scatter + own scatter of each run: 95 % of t intervals hold 3."""
    random = np.random.default_rng(1)
    shared, seeds, repeats = 2.0, 8, 200
    reduction, inside = [], 0

    def drawn(study, names, *rest):
        x = np.array([[point.changes["cells.young"]] for point in study.plan.points])
        y = 3.0 * x + shared * random.standard_normal(seeds) + random.standard_normal((2, seeds))
        return dict.fromkeys(names, y[:, :, None]), []

    monkeypatch.setattr(derivatives, "values_of", drawn)
    monkeypatch.setattr(
        derivatives, "write_study", lambda plan, *_, **__: SimpleNamespace(plan=plan)
    )
    limit = stats.t.isf(0.025, seeds - 1)
    for _ in range(repeats):
        row = mc.gradient(CELL, "diameter", "cells.young", seeds=seeds, step=0.5).rows[0]
        inside += abs(row["derivative"] - 3.0) < limit * row["derivative_se"]
        reduction.append(row["variance_reduction"])
    assert abs(inside / repeats - 0.95) < 3.0 * math.sqrt(0.95 * 0.05 / repeats)
    assert np.median(reduction) == pytest.approx(1.0 + shared**2, rel=0.15)


def test_runs_are_used_again(tmp_path, here):
    options = {"seeds": 2, "output": tmp_path}
    one = mc.gradient(CELL, "diameter", "cells.division_radius", **options)
    assert len(here) == 4
    both = mc.gradient(CELL, ["diameter"], ["cells.division_radius", "cells.young"], **options)
    assert len(here) == 8
    assert both.rows[0] == pytest.approx(one.rows[0], nan_ok=True)
    assert both.rows[1]["derivative"] == 0.0
    assert both.to_pandas()["key"].tolist() == ["cells.division_radius", "cells.young"]
    assert "elasticity" in both.text()


def test_a_run_that_fails_leaves_its_pair_out(monkeypatch):
    inner = engine.run_study

    def failing(runs, folder, **options):
        from dataclasses import replace

        first, *others = inner(runs, folder, **options)
        return [replace(first, state="failed", reason="step failed: no way"), *others]

    monkeypatch.setattr(engine, "run_study", failing)
    found = mc.gradient(CELL, "diameter", "cells.division_radius", seeds=3)
    assert found.rows[0]["seeds"] == 2
    assert "no way" in found.text()


GROWS = mc.load_scene("growth")


@pytest.mark.parametrize(
    ("scene", "changes", "path", "said"),
    [
        (CELL, {"keys": "cells.poisson", "step": 0.5, "scene": {"cells.poisson": 0.45}},
         "cells.poisson", "at most 0.5"),
        (CELL, {"keys": "contact.law"}, "contact.law", "must be a number"),
        (CELL, {"keys": "stop_cells"}, "stop_cells", "is absent"),
        (CELL, {"keys": "initial.count"}, "initial.count", "larger step"),
        (GROWS, {"keys": "integrator.step", "step": 0.1, "scene": {"integrator.step": 5.0}},
         "integrator.step", "no effect"),
        (CELL, {"keys": []}, "keys", "name none"),
        (CELL, {"seeds": 1}, "seeds", "from 2"),
        (CELL, {"times": ["1 h"]}, "times", "between 0 and 600"),
        (GROWS, {"scene": {"stop_cells": 9}}, "stop_cells", "different times"),
    ],
)  # fmt: skip
def test_what_has_no_derivative_is_refused(scene, changes, path, said, here):
    given = {"observables": "diameter", "keys": "cells.division_radius", **changes}
    scene = scene.with_changes(given.pop("scene", {}))
    with pytest.raises(mc.SceneError, match=said) as error:
        mc.gradient(scene, given.pop("observables"), given.pop("keys"), **given)
    assert error.value.path == path
    assert not here


@pytest.mark.slow
def test_coarse_against_fine(tmp_path, here):
    """Volume stays with radius, so that cells of a ball without contact have the same diameter."""
    scene = mc.load_scene("settle").with_changes(
        {"initial.count": 160, "duration": "10 min", "output.every": "10 min"}
    )
    found = mc.compare_coarse(scene, 2, ["cells", "diameter"], seeds=3, output=tmp_path)
    assert len(here) == 6
    row = found.rows[0]
    assert (row["fine"], row["coarse"], row["difference_se"]) == (160.0, 160.0, 0.0)
    row = found.rows[1]
    assert abs(row["relative"]) < 0.1
    runs = [mc.study(s, output=tmp_path / name, seeds=3).to_xarray()["diameter"][:, -1].values
            for name, s in (("fine", scene), ("coarse", mc.coarsen(scene, 2)))]  # fmt: skip
    assert row["difference"] == pytest.approx(runs[1].mean() - runs[0].mean())
    error = math.sqrt(sum(x.var(ddof=1) / 3 for x in runs))
    assert row["difference_se"] == pytest.approx(error)
    assert found.facts["coarse_seconds"] > 0.0
    assert len(here) == 6


@pytest.mark.slow
def test_coarse_against_fine_at_times():
    scene = mc.load_scene("growth").with_changes({"initial.count": 16, "duration": "30 h"})
    found = mc.compare_coarse(scene, 2, seeds=2, times=["10 h", "30 h"])
    assert [row["time"] for row in found.rows if row["observable"] == "cells"] == [36000, 108000]
    with pytest.raises(mc.SceneError, match="from 2"):
        mc.compare_coarse(scene, 2, seeds=1)
    with pytest.raises(mc.SceneError, match="different times"):
        mc.compare_coarse(scene.with_changes({"stop_cells": 40}), 2)
