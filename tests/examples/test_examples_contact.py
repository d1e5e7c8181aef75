"""The examples about contact run, and what they return agrees with closed forms."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from example_programs import is_picture, load
from scipy import optimize


def test_figure_3_3_is_at_rest_in_the_middle_only(tmp_path: Path) -> None:
    doublets = load("figure_3_3").main(tmp_path)
    assert is_picture(tmp_path / "figure_3_3.png")
    sums = {title: sum(d.parts) for title, d in doublets.items()}
    assert sums["Pushed together"] > 1.0
    assert sums["At rest"] == pytest.approx(0.0, abs=1e-12)
    assert sums["Pulled apart"] < -1.0
    rest = doublets["At rest"]
    assert rest.distance == pytest.approx(17.178, abs=5e-4)
    # Hertz at h_0 carries (b² / a) = 6 π σ r_ij
    assert rest.parts[0] == pytest.approx(6 * np.pi * 0.1 * 5.0, rel=1e-12)


@pytest.mark.parametrize("radii", [(10.0, 10.0), (4.0, 9.0)])
def test_figure_3_3_draws_the_contact_plane_where_the_spheres_cut(
    radii: tuple[float, float],
) -> None:
    example = load("figure_3_3")
    doublets = example.setup(radii=radii)
    for doublet in doublets.values():
        ri, rj = radii
        other = doublet.distance - doublet.plane
        assert doublet.half_chord**2 + doublet.plane**2 == pytest.approx(ri**2)
        assert doublet.half_chord**2 + other**2 == pytest.approx(rj**2)
    figure = example.draw(doublets)
    assert len(figure.axes) == 3
    for axes in figure.axes:
        assert axes.get_aspect() == 1.0
        drawn = sorted({float(patch.radius) for patch in axes.patches if hasattr(patch, "radius")})
        assert drawn == sorted(set(radii))


def test_table_3_2_holds_the_roots_of_the_force(tmp_path: Path) -> None:
    example = load("table_3_2")
    rows = example.main(tmp_path)
    assert len(rows) == len(example.RADII) * len(example.KINDS)
    with (tmp_path / "table_3_2.csv").open() as file:
        written = list(csv.DictReader(file))
    assert len(written) == len(rows)
    for row, line in zip(rows, written, strict=True):
        modulus = row.young_kPa / (1.5 * (1 - row.poisson**2))
        radius = row.radius_um / 2

        def force(h: float, modulus: float = modulus, radius: float = radius) -> float:
            sticky = 6 * np.pi * 0.1 * modulus * (radius * h) ** 1.5
            return float(modulus * np.sqrt(radius) * h**1.5 - np.sqrt(sticky))

        # the trivial root h = 0 is left out
        root = optimize.brentq(force, 0.1, 2 * row.radius_um, xtol=1e-13)
        assert row.distance_um == pytest.approx(2 * row.radius_um - root, abs=1e-10)
        assert float(line["distance_um"]) == row.distance_um
        assert row.exact_jkr_distance_um == pytest.approx(2 * row.radius_um - root / 3, abs=1e-10)
        assert row.distance_over_diameter == pytest.approx(row.distance_um / row.radius_um / 2)
    assert "17.178 ( 85.9%)" in example.text(rows)


@pytest.mark.slow
def test_exact_jkr_marks_the_numbers_of_the_theory(tmp_path: Path) -> None:
    example = load("exact_jkr")
    h0, rest, broken, pull_off, first, last = example.main(tmp_path).values()
    assert is_picture(tmp_path / "exact_jkr.png")
    expected = (6 * np.pi * 0.1 * np.sqrt(5.0) * 1.125) ** (2 / 3)
    assert h0 == pytest.approx(expected, rel=1e-12)
    assert rest == pytest.approx(expected / 3, rel=1e-12)
    assert broken == pytest.approx(-3 * expected / 6 ** (4 / 3), rel=1e-12)
    ratios = np.array([pull_off, first, last]) / (np.pi * 0.1 * 5.0)
    np.testing.assert_allclose(ratios, [-3 / 2, -4 / 3, -5 / 6], rtol=1e-12)


def test_exact_jkr_charts_the_model_error_of_the_smoothing() -> None:
    example = load("exact_jkr")
    pair = example.setup()
    ratio = np.array([0.01, 0.1, 0.39, 0.8, 1.5])
    errors = example.smoothing_errors(pair, ratio * pair.h0)
    # from the closed form of the law: (5/168) / (4/7 - 2/5) = 25/144, up to h_0
    binding = 25 / 144 * ratio[:4] ** 1.75
    np.testing.assert_allclose(errors["binding"][:4], binding, rtol=1e-9)
    np.testing.assert_allclose(errors["stiffness"], 5 * ratio**-0.25, rtol=1e-4)
    # the change of force scales with length^{3/4}: it lies inside the smoothed part
    scaled = errors["force"] / ratio**0.75
    np.testing.assert_allclose(scaled, scaled[0], rtol=1e-4)
    assert (errors["depth"][:3] == 0.0).all()
    assert (errors["depth"][3:] > 0.01).all()
    np.testing.assert_allclose(errors["overlap"][:4], 0.0, atol=1e-15)
    assert errors["overlap"][4] > 0.01


def test_the_chart_of_the_smoothing_does_not_depend_on_the_cells() -> None:
    example = load("exact_jkr")
    one, other = example.setup(), example.setup(radius=4.0, young=3.0, surface_energy=0.02)
    ratio = np.array([0.05, 0.7, 1.8])
    first = example.smoothing_errors(one, ratio * one.h0)
    second = example.smoothing_errors(other, ratio * other.h0)
    for name in first:
        np.testing.assert_allclose(first[name], second[name], rtol=1e-6, atol=1e-12)
