# ruff: noqa: E501 - tables of data and what is said of them stand on one line
"""Single specimens, profiles and rates as data of a fit, against closed forms."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cheap_fits
import numpy as np
import pytest
from plain_pde import uncompiled

import multicell as mc
from multicell.calibration.fitting.emulator import best_of, draws
from multicell.calibration.fitting.likelihood import likelihood, scatter_of
from multicell.calibration.fitting.simulator import Reading, SceneSimulator
from multicell.errors import DataError
from multicell.measured.data import read_data
from multicell.measured.noise import Noise
from multicell.population.extents import centre, uniform_radius
from multicell.results.observables import field_at
from multicell.units import oxygen_solubility

SCENE = mc.load_scene("spheroid")
DATA = Path(__file__).parents[2] / "docs" / "data"
MMHG = 0.133322387415


read = partial(cheap_fits.read, scene=SCENE)


def drawn(seed, specimens=8, days=(3, 5, 8), spread=12.0, same=False):
    """Return a table of diameters and cores of specimens that differ, correlated within each."""
    rng = np.random.default_rng(seed)
    table = {"day": [], "diameter / um": [], "necrotic_radius / um": [], "specimen": []}
    own = rng.standard_normal(specimens)
    for day in days:
        for k in range(specimens):
            size = own[k] if same else rng.standard_normal()
            table["day"].append(day)
            table["diameter / um"].append(100.0 + 40.0 * day + spread * size)
            table["necrotic_radius / um"].append(20.0 * day + 5.0 * (size + rng.standard_normal()))
            table["specimen"].append(f"s{k}" if same else "")
    return table


def test_single_specimens_become_mean_spread_and_number(tmp_path):
    table = drawn(0, specimens=400)
    found = read_data(table, SCENE)
    assert [d.time for d in found.data[::2]] == [3 * 86400.0, 5 * 86400.0, 8 * 86400.0]
    values = np.array(table["diameter / um"]).reshape(3, 400)
    for datum, row in zip(found.data[::2], values, strict=True):
        assert datum.value == pytest.approx(row.mean())
        assert datum.sigma == pytest.approx(row.std(ddof=1) / 20.0, rel=0.01)
        assert (len(datum.specimens), datum.tissues, datum.assumed) == (400, math.inf, False)
    del table["specimen"]
    stated = read_data(table, SCENE, specimens="single")
    assert [(d.value, d.sigma) for d in stated.data] == [(d.value, d.sigma) for d in found.data]


def test_few_specimens_are_moderated_by_the_others_of_their_observable(tmp_path):
    text = "day, diameter / um, specimen\n1, 100,\n1, 102,\n2, 200,\n3, 300,\n3, 318,\n3, 330,\n"
    one, alone, three = read(text, tmp_path).data
    variances = {
        1: np.var([100, 102], ddof=1) / 101**2,
        3: np.var([300, 318, 330], ddof=1) / 316**2,
    }
    pooled = (variances[1] + variances[3]) / 2
    assert one.sigma == pytest.approx(101 * math.sqrt((variances[1] + pooled) / 2 / 2))
    assert alone.sigma == pytest.approx(200 * math.sqrt(pooled))
    assert three.sigma == pytest.approx(316 * math.sqrt((2 * variances[3] + pooled) / 3 / 3))


def test_zeros_without_spread_are_known_to_the_radius_of_a_cell(tmp_path):
    text = "day, necrotic_radius / um, specimen\n" + "3, 0,\n" * 9 + "9, 40,\n9, 44,\n"
    zero, later = read(text, tmp_path).data
    assert zero.sigma == SCENE.cells.division_radius
    assert later.sigma == pytest.approx(2.0)
    stated = read(text.replace("specimen", "necrotic_radius sd / um, specimen").replace(",\n", ", 6,\n"), tmp_path)  # fmt: skip
    assert stated.data[0].sigma == pytest.approx(6.0 / 3.0)


def test_days_on_which_cores_begin_do_not_blur_the_others():
    """Ratios as of spheroids whose inhibited core begins on day 3: later spreads stay their own."""
    late, sd = [[0.85, 0.89, 0.87], [0.88, 0.90, 0.92], [0.91, 0.89, 0.93]], 0.02
    table = {"day": np.repeat([3, 4, 5, 6], 3), "packing_ratio": [0.0, 0.0, 0.23, *np.ravel(late)]}
    table["packing_ratio sd"] = [1e-3] * 12
    found = read_data(table, SCENE, specimens="single").data
    for datum in found[1:]:
        assert datum.sigma == pytest.approx(sd / math.sqrt(3.0), rel=0.01)
    first = np.var([0.0, 0.0, 0.23], ddof=1)
    assert found[0].sigma == pytest.approx(math.sqrt((2.0 * first + sd**2) / 3.0 / 3.0), rel=1e-6)


def test_specimens_of_one_day_share_errors_and_those_of_other_days_do_not():
    noise = Noise.of(read_data(drawn(1, specimens=300), SCENE).data)
    expected = np.kron(np.eye(3), [[1.0, math.sqrt(0.5)], [math.sqrt(0.5), 1.0]])
    assert noise.errors == pytest.approx(expected, abs=0.12)
    assert (noise.shared == 0.0).all()
    assert noise.freedom == 300.0
    # the same ones again: their diameters agree, their cores in the part that is theirs
    repeated = Noise.of(read_data(drawn(1, specimens=300, same=True), SCENE).data).errors
    assert repeated[::2, ::2] == pytest.approx(0.9 + 0.1 * np.eye(3), abs=1e-6)
    assert repeated[1, 3] == pytest.approx(0.5, abs=0.15)


def test_a_single_specimen_a_day_scatters_as_runs_do(tmp_path):
    other = Noise.of(read("day, diameter / um, specimen\n1, 100,\n2, 150,\n", tmp_path).data)
    assert other.shared == pytest.approx(np.eye(2))
    same = Noise.of(read("day, diameter / um, specimen\n1, 100, a\n2, 150, a\n", tmp_path).data)
    assert same.shared == pytest.approx(np.ones((2, 2)))
    assert same.errors == pytest.approx(np.eye(2))


REFUSED = {
    "day, diameter / um, diameter n, specimen\n5, 7, 3, a\n": "has a 'diameter sem' or 'diameter n', and is a single specimen",
    "day, diameter / um, specimen\n5, 7, a\n5, 8, a\n": "line 3: measures 'diameter' of a specimen for the second time",
    "day, diameter / um, specimen\n5, 7, a\n5, 7, b\n": "line 2 and 1 more: has specimens that agree exactly in 'diameter'. Add a column 'diameter sd'",
    "day, diameter / um, specimen / um\n5, 7, a\n": "'specimen / um': has the unit 'um', must have none",
    "day, oxygen / mM\n5, 0.1\n": "line 2, 'oxygen / mM': has no depth. A field has a value at a 'depth / um'",
    "day, depth / um, diameter / um\n5, 7, 300\n": "'diameter / um': has a depth, and is no field",
    "day, depth / um, oxygen / mmHg\n5, 7, 0\n": "is 0, of which a relative standard deviation says nothing. Add a column 'oxygen sd' with its unit.",
}  # fmt: skip


@pytest.mark.parametrize("text", REFUSED)
def test_what_cannot_be_used_is_named(text, tmp_path):
    with pytest.raises(DataError) as caught:
        read(text, tmp_path)
    assert REFUSED[text] in str(caught.value)


def test_glucose_has_no_partial_pressure(tmp_path):
    scene = mc.load_scene("emt6")
    with pytest.raises(DataError, match="'glucose / mmHg': is '1 mmHg', a partial pressure"):
        read("day, depth / um, glucose / mmHg\n5, 7, 3\n", tmp_path, scene=scene)


# likelihoods


def straight(values, sigma, noise, slopes):
    """Return an emulator of values + slopes (x - 1/2), exact at sixteen points."""
    from scipy.stats import qmc

    shares = qmc.Sobol(slopes.shape[1], rng=1).random(16)
    away = ((shares - 0.5) @ slopes.T + values[0] - values[1]) / sigma
    return cheap_fits.through(shares, away, noise=noise)


def test_a_hierarchy_of_specimens_has_the_variance_of_its_levels():
    """One level from three days of twelve specimens: τ²/n over three days, and that of the mean."""
    rng = np.random.default_rng(8)
    table = {
        "day": np.repeat([1, 2, 3], 100),
        "diameter / um": 100.0 + 9.0 * rng.standard_normal(300),
    }
    data = read_data(table, SCENE, specimens="single").data
    noise, sigma = Noise.of(data), np.array([d.sigma for d in data])
    values = np.array([d.value for d in data])
    model = straight((100.0, values), sigma, noise, np.full((3, 1), 20.0))
    runs = 4.0 * np.repeat(rng.standard_normal((400, 1)), 3, axis=1) / sigma
    found = likelihood(
        model, noise, np.array([0.5]), scatter_of(runs - runs.mean() + (100.0 - values) / sigma)
    )
    # tissues' scatter is in the spread: of runs counts only the error of their mean
    expected = math.sqrt(81.0 / 300.0 + 16.0 / 400.0) / 20.0
    assert found.draws().std() == pytest.approx(expected, rel=0.1)


TIMES = np.arange(1.0, 7.0)


def growth(shares):
    """Return six diameters and six cores of parameters (k, 2), µm."""
    x = np.atleast_2d(shares)
    return np.concatenate([100.0 + 20.0 * x[:, :1] * TIMES, 40.0 + 15.0 * x[:, 1:] * TIMES], axis=1)


def _specimens(truth, rng, *, same):
    rows = {"time / h": [], "diameter / um": [], "necrotic_radius / um": [], "specimen": []}
    own = rng.standard_normal((8, 2))
    for k, time in enumerate(TIMES):
        for s in range(8):
            tissue = own[s] if same else rng.standard_normal(2)
            away = np.array([12.0 * tissue[0], 6.0 * tissue[0] + 3.0 * tissue[1]])
            away += 3.0 * rng.standard_normal(2)
            for title, value in zip(
                list(rows),
                (time, truth[k] + away[0], truth[6 + k] + away[1], f"s{s}" if same else ""),
                strict=True,
            ):
                rows[title].append(value)
    return rows


@pytest.mark.slow
@pytest.mark.harness
@pytest.mark.parametrize("same", [False, True])
def test_intervals_cover_with_scatter_that_data_show(same, request):
    """80 and 95 % intervals of two parameters; those of the same specimens may be somewhat wide."""
    from scipy.stats import qmc

    count = request.config.getoption("--calibrations") or 6
    rng, hits = np.random.default_rng(5), []
    shares = qmc.Sobol(2, rng=1).random(16)
    for _ in range(count):
        truth = 0.3 + 0.4 * rng.random(2)
        table = _specimens(growth(truth)[0], rng, same=same)
        found = sorted(read_data(table, SCENE).data, key=lambda d: (d.observable, d.time))
        noise = Noise.of(found)
        values, sigma = (np.array([getattr(d, x) for d in found]) for x in ("value", "sigma"))
        names = [d.observable for d in found]
        away = (growth(shares) - values) / sigma
        model = cheap_fits.through(shares, away, observables=names, noise=noise)
        best = best_of(model.loss, model.prior, draws(model.loss, model.prior, seed=0, count=300))
        runs = np.tile((growth(best)[0] - values) / sigma, (12, 1))
        posterior = likelihood(model, noise, best, scatter_of(runs))
        sample = posterior.draws(1000)
        ends = [np.quantile(sample, [0.5 - x / 2, 0.5 + x / 2], axis=0) for x in (0.8, 0.95)]
        hits.append([(low <= truth) & (truth <= high) for low, high in ends])
    print(same, np.mean(hits, axis=0).tolist())
    for level, part in zip((0.8, 0.95), np.mean(hits, axis=0), strict=True):
        bound = 3.0 * math.sqrt(level * (1.0 - level) / count)
        assert part.min() >= level - bound


# profiles and rates


def small(geometry):
    """Return a ball of cells in a field of oxygen at rest."""
    layer = {"nutrients.oxygen.layer": "60 um"} if geometry == "radial" else {}
    return SCENE.with_changes(
        {"initial.count": 150, "duration": "2 min", "coupling_step": "1 min",
         "nutrients.oxygen.geometry": geometry, "nutrients.oxygen.boundary": "0.2 mM", **layer}
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("geometry", ["box", "radial"])
def test_a_profile_is_the_mean_of_the_field_over_a_sphere(geometry):
    scene = small(geometry)
    simulation = mc.Simulation(scene, threads=1)
    cells, field = simulation.cells, simulation.fields["oxygen"]
    middle = centre(cells, 3)
    radius = uniform_radius(cells, middle, 3)
    rng = np.random.default_rng(0)
    way = rng.standard_normal((4000, 3))
    way /= np.linalg.norm(way, axis=1)[:, None]
    there = field.to_pde()
    for depth in (-10.0, 5.0, 15.0, 0.9 * radius):
        places = np.array([[radius - depth]])
        if geometry == "box":
            places = middle + (radius - depth) * way
        with uncompiled():
            expected = there.interpolate(places).mean()
        assert field_at(field, middle, radius - depth) == pytest.approx(expected, rel=0.03)
    table = {
        "time / min": [2, 2, 1.5, math.nan],
        "depth / um": [-1e3, 10, 10, 10],
        "oxygen / mmHg": [140, 90, 90, 90],
    }
    measured = read_data(table, scene)
    (outside, *inside), reason = (lambda x: (x.values, x.reason))(
        SceneSimulator.of(measured, ())([], 0, 1)
    )
    assert reason == ""
    assert outside == pytest.approx(0.2, rel=0.02)
    assert inside[0] == inside[2]
    assert inside[1] == pytest.approx(inside[0], rel=0.05)
    assert inside[0] == pytest.approx(field_at(field, middle, radius - 10.0), rel=0.05)


def test_pressures_of_oxygen_become_concentrations_as_in_scenes(tmp_path):
    text = "day, depth / um, oxygen / mmHg, oxygen sd / mmHg\n5, -7, 38, 2\n"
    (datum,) = read(text, tmp_path).data
    one = MMHG * oxygen_solubility(SCENE.nutrients["oxygen"].temperature)
    assert (datum.value, datum.sigma) == (pytest.approx(38 * one), pytest.approx(2 * one))
    assert datum.depth == -7.0
    percent = read("day, depth / um, oxygen / %\n5, 7, 5\n", tmp_path).data[0]
    boundary = SCENE.with_changes({"nutrients.oxygen.boundary": "5 %"}).nutrients["oxygen"].boundary
    assert percent.value == pytest.approx(boundary)


def test_rates_of_uptake_follow_from_what_cells_find():
    """Michaelis-Menten of every cell at its concentration; a steady field takes in as much."""
    simulation = mc.Simulation(small("box"), threads=1)
    row, cells = simulation.history_row(), simulation.cells
    part = simulation.scene.nutrients["oxygen"]
    found = simulation.concentrations["oxygen"]
    capacity = part.largest_uptake(cells.volume if part.uptake_per_volume else 0.0)
    expected = (capacity * found / (part.half_saturation + found))[cells.state == 0].sum()
    assert row["uptake_oxygen"] == pytest.approx(expected, rel=0.02)
    begin = simulation.ledger["oxygen"].uptake
    simulation.step()
    step = simulation.time
    assert simulation.ledger["oxygen"].uptake - begin == pytest.approx(row["uptake_oxygen"] * step)
    volume = math.pi / 6.0 * row["diameter"] ** 3
    assert row["rim_uptake_oxygen"] == pytest.approx(row["uptake_oxygen"] / volume)


def test_measured_profiles_and_consumption_of_emt6_can_be_read():
    scene = mc.load_scene("emt6-rim")
    profiles = read_data(DATA / "emt6-po2.csv", scene)
    assert len(profiles.data) == 17
    assert [c.changes["initial.count"] for c in profiles.conditions] == [9620, 3993]
    rates = read_data(DATA / "emt6-consumption.csv", scene)
    # 4.81e-4 cm³ per cm³ and s of 22.4 l/mol
    assert rates.data[5].value == pytest.approx(4.81e-4 / 22.4 * 1e3, rel=1e-3)
    assert len(rates.conditions) == 8


@dataclass(frozen=True)
class Decaying:
    """Oxygen that falls off with depth: over a length of 20 to 120 µm."""

    depths: tuple[float, ...]

    def __call__(self, shares, condition, seed):
        length = 20.0 + 100.0 * shares[0]
        return Reading(tuple(0.2 * math.exp(-x / length) for x in self.depths))


@pytest.mark.slow
def test_a_fit_to_a_profile_finds_the_length_over_which_it_falls():
    depths, rng = np.linspace(5.0, 95.0, 10), np.random.default_rng(2)
    values = 0.2 * np.exp(-depths / 60.0) * (1.0 + 0.05 * rng.standard_normal(10))
    table = {"day": [3] * 10, "depth / um": depths, "oxygen / mM": values}
    fit = mc.fit(
        SCENE, table, {"growth.cycle_time": "20:120 h"}, cores=1, sd=0.05,
        simulator=Decaying(tuple(depths)),
    )  # fmt: skip
    interval = fit.intervals()["cycle_time"]
    assert interval.low < 60.0 * 3600.0 < interval.high
    assert interval.high - interval.low < 10.0 * 3600.0
    assert [row["depth"] for row in fit.rows()] == depths.tolist()
    assert fit.best.per_datum == pytest.approx(1.0, abs=0.5)
    (axes,) = fit.plot().axes
    assert axes.get_xlabel() == "depth below the surface (µm)"
