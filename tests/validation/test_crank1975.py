"""Diffusion into balls and slabs, by the series of Crank, The Mathematics of Diffusion (1975)."""

import numpy as np
import pytest
from layers import LEVEL, SIZE, along, ends_of, layers_of
from pde import SphericalSymGrid
from scipy.optimize import brentq

import multicell as mc
from multicell.nutrient.balance import BALANCE_COLUMNS
from multicell.nutrient.equations.equation import FieldEquation
from multicell.nutrient.equations.solvers import MarchFieldSolver
from multicell.nutrient.equations.substance import Substance
from multicell.nutrient.field import NutrientField
from multicell.nutrient.parameters import FieldParameters
from multicell.nutrient.tissue import Tissue
from multicell.scene.nutrient import Nutrient

SUBJECT, SOURCE = "fields", "crank1975"
D = 2000.0
KINDS = ["cubes", "squares", "shells"]


def series(r, t, radius=100.0):
    """Crank's series for a ball whose surface is held at 1 (The Mathematics of Diffusion, 6.18)."""
    k = np.arange(1, 400)[:, None]
    terms = (-1.0) ** k / k * np.sin(k * np.pi * r / radius)
    decay = np.exp(-1000.0 * (k * np.pi / radius) ** 2 * t)
    return 1.0 + 2.0 * radius / (np.pi * r) * (terms * decay).sum(axis=0)


def test_diffusion_into_a_ball_follows_the_series(compare):
    for t in (0.5, 2.0, 6.0):
        equation = FieldEquation(SphericalSymGrid(100.0, 100), {"a": Substance(1000.0, 1.0)})
        state = equation.state({"a": 0.0})
        solver = MarchFieldSolver(equation, tolerance=1e-4, scales=np.ones(1))
        solver.make_stepper(state)(state, 0.0, t)
        c, amounts = state.data, dict(zip(BALANCE_COLUMNS, solver.info["amounts"][0], strict=True))
        off = np.abs(c - series(np.arange(100) + 0.5, t)).max()
        compare.deviation(
            f"diffusion into a ball, {t:g} s, march of runs", "series (6.18)", off, 5e-3
        )
        stored = float(np.sum(equation.layout.volumes * c))
        assert amounts["inflow"] == pytest.approx(stored, rel=1e-9)
        assert amounts["outflow"] == 0.0
        assert c.min() >= 0.0


@pytest.mark.parametrize("t", [0.5, 2.0, 6.0])
def test_a_stirred_medium_diffuses_into_a_ball(t, compare):
    substance = mc.Substance(1000.0, 1.0, medium=1.0)
    into = mc.FieldEquation(SphericalSymGrid(100.0, 100), {"a": substance})
    march = {"solver": "multicell-march", "tolerance": 1e-4}
    c = into.solve(into.state({"a": 0.0}), t, tracker=None, **march).data
    off = np.abs(c - series(np.arange(100) + 0.5, t)).max()
    compare.deviation(f"diffusion into a ball, {t:g} s, from Python", "series (6.18)", off, 5e-4)


@pytest.mark.parametrize("ratio", [0.3, 1.0, 5.0])
def test_a_sphere_in_a_stirred_solution_of_limited_volume(ratio, compare):
    """Crank (1975), eqs. 6.30-6.32: what the sphere has taken up, over what it will."""
    diffusion, margin = 500.0, 100.0
    nutrient = Nutrient(
        diffusion=diffusion, boundary=0.0, uptake=0.0, media=[(1.0, 2.0)], geometry="radial",
        margin=margin, time_tolerance=1e-4, finite_medium={"volume": 1e12},
    )  # fmt: skip
    parameters = FieldParameters(nutrient, 1.0, 10.0, "transient", dimensions=3)
    place, nothing = np.zeros((1, 3)), np.zeros(1)
    probe = NutrientField("a", parameters)
    probe.group.fill(Tissue(place), time=0.0)
    a = probe.layout.radius
    sphere = 4.0 / 3.0 * np.pi * a**3
    finite = {"volume": (1.0 + ratio) * sphere}
    whole = Nutrient(**{**vars(nutrient), "finite_medium": finite})
    field = NutrientField("a", FieldParameters(whole, 1.0, 10.0, "transient", dimensions=3))
    field.group.fill(Tissue(place), time=0.0)
    field.attach_medium()
    assert field.well_mixed.volume == pytest.approx(ratio * sphere)
    still = Tissue(place), {"a": (nothing, None)}
    field.group.advance(*still, begin=0.0, end=1.0)
    assert field.well_mixed.concentration == 2.0
    roots = [
        brentq(lambda q: (3 + ratio * q * q) * np.sin(q) - 3 * q * np.cos(q), low, low + np.pi)
        for low in np.pi * np.arange(1, 400)
    ]
    q, now = np.array(roots), 1.0
    final = 2.0 * ratio * sphere / (1.0 + ratio)
    for time in (0.5, 2.0, 6.0):
        field.group.advance(*still, begin=now, end=1.0 + time)
        now = 1.0 + time
        terms = 6 * ratio * (ratio + 1) * np.exp(-diffusion * q**2 * time / a**2)
        exact = 1.0 - np.sum(terms / (9 + 9 * ratio + q**2 * ratio**2))
        what = f"sphere in {ratio:g} of its volume of stirred solution, uptake by {time:g} s (6.30)"
        compare.value(what, exact, field.stored() / final, 2e-3)
        assert field.stored() + field.well_mixed.amount == pytest.approx(
            2 * ratio * sphere, rel=1e-8
        )


def exact_filling(kind, x, t, decay):
    """Return the filling of an empty slab or ball whose sides are held at LEVEL (Crank 1975)."""
    size, k = SIZE[kind], np.sqrt(decay / D)
    n = np.arange(1, 400)[:, None]
    if kind == "shells":
        waves = n * np.pi / size
        rest = size * np.sinh(k * x) / (x * np.sinh(k * size))
        size_of = 2.0 * np.where(n % 2 == 1, 1.0, -1.0) * waves / (waves**2 + k**2) / x
    else:
        waves = n * np.pi / size
        rest = np.cosh(k * (x - 0.5 * size)) / np.cosh(0.5 * k * size)
        size_of = np.where(n % 2 == 1, 4.0, 0.0) / (n * np.pi) * waves**2 / (waves**2 + k**2)
    gone = np.exp(-D * (waves**2 + k**2) * t)
    return LEVEL * (rest - np.sum(size_of * np.sin(waves * x) * gone, axis=0))


@pytest.mark.parametrize("kind", KINDS)
def test_transients_follow_the_closed_form(kind, compare):
    decay, errors = 0.3, []
    for times in (1, 2):
        grid = layers_of(kind, times)
        equation = FieldEquation(grid, {"oxygen": Substance(D, ends_of(kind), decay=decay)})
        empty = equation.state({"oxygen": 0.0})
        end = 0.3 * SIZE[kind] ** 2 / (np.pi**2 * D)
        exact = exact_filling(kind, grid.axes_coords[0], end, decay)
        assert exact.min() < 0.5 * LEVEL
        ours = equation.solve(empty, end, solver="multicell-implicit", rtol=1e-8, tracker=None)
        errors.append(np.abs(along(kind, ours.data) - exact).max())
    largest = errors[0] / LEVEL
    compare.deviation(
        f"filling with decay, {kind}, over the level outside", "series", largest, 5e-3
    )
    what = f"filling with decay, {kind}: gain of half the spacing"
    compare.value(what, 4.0, errors[0] / errors[1], 0.6)
