"""The examples run, and what they return agrees with closed forms and SciPy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from example_programs import EXAMPLES, is_picture, load
from scipy import optimize

import multicell as mc


def test_every_example_states_problem_cost_and_command() -> None:
    files = sorted(EXAMPLES.glob("*.py"))
    assert [f.stem for f in files] == [
        "confinement", "exact_jkr", "figure_3_3", "fit_growth", "fusion", "hypoxia_switched",
        "jkr_curves", "monolayer_front", "own_growth_law", "own_integrator", "own_law",
        "own_observable", "slurm_study", "small_spheroid", "sorting_types", "study", "table_3_2",
        "two_cells",
    ]  # fmt: skip
    for file in files:
        words = load(file.stem).__doc__
        for word in ("Problem", "Scaling", "Cost", f"python examples/{file.name}"):
            assert word in words


def test_jkr_curves_are_drawn(tmp_path: Path) -> None:
    assert len(load("jkr_curves").main(tmp_path)) == 4
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


@pytest.mark.slow
def test_own_laws_bring_cells_to_rest_as_ours_do() -> None:
    ends = load("own_law").main()
    scene = mc.load_scene("settle").with_changes({"initial.count": 50, "duration": "20 min"})
    ours = mc.run(scene.with_changes({"contact": mc.JKR(surface_energy=0.1)})).frames[-1].cells
    np.testing.assert_allclose(ends["Sticky"], ours.position, atol=1e-6)
    # a law that only repels spreads them further
    assert ends["Square"].std() > 1.1 * ends["Sticky"].std()


@pytest.mark.slow
def test_the_hypoxic_core_has_the_radius_of_the_closed_form(tmp_path: Path) -> None:
    radii = load("hypoxia_switched").main(tmp_path)
    assert radii["hypoxic"] == pytest.approx(radii["closed form"], rel=0.02)
    assert radii["hypoxic"] > 30.0
    assert radii["otherwise"] == 0.0
    assert is_picture(tmp_path / "hypoxia_switched.png")


def test_the_closed_form_of_the_core_solves_the_equation_of_diffusion() -> None:
    """Found again by integrating c'' + 2 c'/r = q/D from the centre outwards."""
    from scipy.integrate import solve_ivp

    example = load("hypoxia_switched")
    radius, cells = 60.0, 1400.0
    q = cells * example.UPTAKE / (4 / 3 * np.pi * radius**3)
    core = float(example.closed_form(np.array(radius), np.array(cells), np.array(0.028)))
    at = example.THRESHOLD - q * core**2 / (6 * example.DIFFUSION)  # at the centre

    def slopes(r: float, y: np.ndarray) -> list[float]:
        return [y[1], (q / example.DIFFUSION if r < radius else 0.0) - 2 * y[1] / r]

    ends = (1e-6, radius), (radius, radius + example.LAYER)
    inner = solve_ivp(slopes, ends[0], [at, 0.0], rtol=1e-10, atol=1e-14).y[:, -1]
    outer = solve_ivp(slopes, ends[1], inner, rtol=1e-10, atol=1e-14).y[0, -1]
    assert 0.0 < core < radius
    assert outer == pytest.approx(0.028, rel=1e-6)


def test_the_pressure_of_a_gel_is_the_integral_of_its_stresses() -> None:
    from scipy.integrate import quad

    pressure = load("confinement").pressure
    for stretch in (1.01, 1.3, 3.0):
        exact = quad(lambda x: 2 * 10.0 * (1 + x**3) / x**5, 1.0, stretch)[0]
        assert pressure(np.array(12.0 * stretch), 30.0) == pytest.approx(exact, rel=1e-9)


@pytest.mark.slow
def test_a_gel_stops_growth_as_the_equation_for_the_volume_says(tmp_path: Path) -> None:
    example = load("confinement")
    short = {"duration": "1.25 d"}
    for ours, line in example.main(tmp_path, **short).values():
        assert ours > 12.5
        assert ours == pytest.approx(line, rel=0.08)
    assert is_picture(tmp_path / "confinement.png")


@pytest.mark.slow
def test_only_cells_that_prefer_their_like_sort(tmp_path: Path) -> None:
    parts = load("sorting_types").main(tmp_path, duration="5 h")
    assert parts["random mixture"] == pytest.approx(0.5, abs=0.01)
    assert parts["all stick alike"] == pytest.approx(parts["random mixture"], abs=0.06)
    assert parts["like cells stick more"] < 0.4
    assert is_picture(tmp_path / "sorting_types.png")


@pytest.mark.slow
def test_the_front_of_a_monolayer_moves_as_its_edge_grows(tmp_path: Path) -> None:
    found = load("monolayer_front").main(tmp_path, stop_cells=700)
    assert found["speed"] == pytest.approx(found["balance"], rel=0.15)
    assert 0.6 * found["unlimited"] < found["rate"] < 1.1 * found["unlimited"]
    assert is_picture(tmp_path / "monolayer_front.png")


def test_two_drops_become_one_ball() -> None:
    ratio = load("fusion").drops(np.array([0.0, 0.1, 1.0, 200.0]))
    assert ratio[0] == pytest.approx(np.sqrt(1.2 / 0.2), rel=0.01)  # two balls that touch
    assert (np.diff(ratio) < 0.0).all()
    assert ratio[-1] == pytest.approx(1.0, abs=0.01)


@pytest.mark.slow
def test_two_spheroids_fuse_and_stop_before_they_are_a_ball(tmp_path: Path) -> None:
    found = load("fusion").main(tmp_path, duration="6 h")
    assert 1.0 < found["liquid"] < found["tissue"] < 1.6
    assert is_picture(tmp_path / "fusion.png")
