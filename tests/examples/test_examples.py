"""The examples run, and what they return agrees with closed forms and SciPy."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from scipy import optimize

import multicell as mc

EXAMPLES = Path(__file__).parents[2] / "examples"


def load(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(f"example_{name}", EXAMPLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    # dataclasses look their module up by name
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def is_picture(path: Path) -> bool:
    return path.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n" and path.stat().st_size > 10_000


def test_every_example_states_problem_cost_and_command() -> None:
    files = sorted(EXAMPLES.glob("*.py"))
    assert [f.stem for f in files] == [
        "exact_jkr", "figure_3_3", "fit_growth", "jkr_curves", "own_growth_law",
        "own_integrator", "own_law", "own_observable", "slurm_study", "small_spheroid", "study",
        "table_3_2",
        "two_cells",
    ]  # fmt: skip
    for file in files:
        words = load(file.stem).__doc__
        for word in ("Problem", "Scaling", "Cost", f"python examples/{file.name}"):
            assert word in words


def test_jkr_curves_reproduce_the_published_figure(tmp_path: Path) -> None:
    results = load("jkr_curves").main(tmp_path)
    expected = [(17.178, -2.3562), (18.030, -2.3562), (18.222, -2.3562), (15.520, -4.7124)]
    np.testing.assert_allclose(list(results.values()), expected, atol=5e-4)
    assert is_picture(tmp_path / "jkr_curves.png")


def test_jkr_curves_cross_zero_where_they_say() -> None:
    for curve in load("jkr_curves").setup():
        root = optimize.brentq(curve.force, 10.0, 19.0, xtol=1e-12)
        assert curve.equilibrium() == pytest.approx(root, abs=1e-9)
        assert curve.force(np.array([20.0, 25.0])).tolist() == [0.0, 0.0]


def test_two_cells_agree_with_scipy(tmp_path: Path) -> None:
    errors = load("two_cells").main(tmp_path)
    assert list(errors) == ["cvode", "euler"]
    assert errors["cvode"] < 0.005
    assert 0.005 < errors["euler"] < 0.2
    assert is_picture(tmp_path / "two_cells.png")


def test_two_cells_come_to_rest_at_the_equilibrium_distance() -> None:
    example = load("two_cells")
    time, distance = example.distances(example.setup("cvode", atol=1e-6, rtol=1e-8))
    assert time[0] == 0.0
    assert time[-1] == 3600.0
    assert distance[0] == pytest.approx(example.START, rel=1e-12)
    h = (6 * np.pi * 0.1 * np.sqrt(5.0) / (8.0 / 9.0)) ** (2 / 3)
    assert distance[-1] == pytest.approx(20.0 - h, abs=1e-4)
    assert example.reference(time)[-1] == pytest.approx(20.0 - h, abs=1e-6)


def test_euler_is_of_first_order_on_two_cells() -> None:
    example = load("two_cells")
    errors = []
    for step in (10.0, 5.0, 2.5):
        time, distance = example.distances(example.setup("euler", step=step))
        errors.append(np.abs(distance - example.reference(time)).max())
    order = np.polyfit(np.log([10.0, 5.0, 2.5]), np.log(errors), 1)[0]
    assert order == pytest.approx(1.0, abs=0.15)


@pytest.mark.slow
def test_small_spheroid_is_limited_by_oxygen(tmp_path: Path) -> None:
    summary = load("small_spheroid").main(tmp_path / "out")
    states = summary["states"]
    assert summary["cells"] == sum(states.values())
    assert states.pop("apoptotic") == 0
    assert all(count > 10 for count in states.values())
    # without a limit 80 cells would have become 80 * 2^(72 / 15), about 2200
    assert 300 < summary["cells"] < 1000
    assert 0.0 < summary["necrotic_radius"] < 0.5 * summary["diameter"]
    assert summary["ledger"]["relative_remainder"] < 1e-8
    for name in ("growth", "section", "profiles"):
        assert is_picture(tmp_path / "out" / f"{name}.png")
    assert (tmp_path / "out" / "report.html").stat().st_size > 10_000


def test_an_own_growth_law_has_the_volumes_that_follow_from_it() -> None:
    """Ages have the density 2 ln2 2^-a in cycles, so that the mean volume is known."""
    example = load("own_growth_law")
    volumes = example.main()
    age = (np.arange(4000) + 0.5) / 4000
    density = 2.0 * np.log(2.0) * 2.0**-age
    law = example.Bertalanffy(largest=2.2)
    means = {
        "linear": np.mean(density * (1.0 + age)),
        "Bertalanffy": np.mean(density * law.volume_after(np.ones(4000), age)),
    }
    ratio = volumes["Bertalanffy"].mean() / volumes["linear"].mean()
    assert ratio == pytest.approx(means["Bertalanffy"] / means["linear"], rel=0.06)


def test_own_observables_are_recorded_as_frames_have_them() -> None:
    example = load("own_observable")
    result = example.main()
    last = result.frames[-1]
    dividing = last.cells.state == mc.State.PROLIFERATING
    away = np.linalg.norm(last.cells.position - last.cells.position.mean(axis=0), axis=1)
    assert result.history["rim_ratio"][-1] == pytest.approx(away[dividing].mean() / away.mean())
    assert result.history["rim_ratio"][-1] > 1.02
    volume = 4.0 / 3.0 * np.pi * (last.cells.radius[dividing] ** 3).sum()
    assert result.summary()["dividing_volume"] == pytest.approx(volume, rel=1e-12)


def test_own_laws_bring_cells_to_rest_as_ours_do() -> None:
    ends = load("own_law").main()
    scene = mc.load_scene("settle").with_changes({"initial.count": 50, "duration": "20 min"})
    ours = mc.run(scene.with_changes({"contact": mc.JKR(surface_energy=0.1)})).frames[-1].cells
    np.testing.assert_allclose(ends["Sticky"], ours.position, atol=1e-6)
    # a law that only repels spreads them further
    assert ends["Square"].std() > 1.1 * ends["Sticky"].std()
