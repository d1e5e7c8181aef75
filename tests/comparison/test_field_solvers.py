"""Solvers of fields against each other: problems, references, failures, charts."""

import itertools
import json
import math

import numpy as np
import pytest
from scipy.optimize import brentq

import multicell as mc
from multicell.comparison.field_solvers import measure
from multicell.comparison.field_solvers.compare import frame_at
from multicell.comparison.field_solvers.equations import (
    CUBES,
    SHELLS,
    SQUARES,
    coarse_means,
    geometries,
    grids,
)
from multicell.comparison.field_solvers.measure import (
    NO_CONVERGENCE,
    RIGHT,
    RUNS_AWAY,
    TOO_SLOW,
    Bench,
    stability_rows,
)
from multicell.comparison.field_solvers.problems import (
    KINDS,
    STEADY,
    SWITCH,
    TRANSIENT,
    case,
    fastest_rate,
)
from multicell.comparison.field_solvers.reference import of_grids, on_one_grid
from multicell.comparison.field_solvers.solvers import SOLVERS, neighbours
from multicell.comparison.files import DONE, FAILED
from multicell.comparison.measure import Effort

AIR = {"boundary": "0.07 mM", "uptake": "20 amol/s", "spacing": "15 um", "height": "10 um"}


def scene_with(oxygen=None, **changes):
    scene = mc.load_scene("growth")
    return scene.with_changes(
        {
            "initial.count": 60,
            "duration": "40 s",
            "coupling_step": "20 s",
            "nutrients.oxygen": AIR | (oxygen or {}),
        }
        | changes
    )


def bench_of(problem):
    return Bench(problem, on_one_grid(problem), "kernels")


def problem_of(scene, kind, geometry=CUBES, rung=1):
    frame = frame_at(scene, None, 1, print)
    layout = grids(scene, frame, "oxygen", geometry, rung + 1)[rung]
    return case(scene, frame, "oxygen", kind, layout)


# --- problems -------------------------------------------------------------------------------------


@pytest.mark.parametrize("geometry", [CUBES, SHELLS, SQUARES])
def test_grids_are_nested_and_means_keep_amounts(geometry):
    scene = scene_with(dimensions=2) if geometry == SQUARES else scene_with()
    frame = frame_at(scene, None, 1, print)
    coarse, middle, fine = grids(scene, frame, "oxygen", geometry, 3)
    assert coarse.spacing == pytest.approx(4.0 * fine.spacing, rel=1e-12)
    assert middle.spacing <= 15.0 * (1.0 + 1e-9)
    position = frame.cells.position * ([1, 1, 0] if geometry == SQUARES else [1, 1, 1])
    rng = np.random.default_rng(4)
    values = rng.random(fine.filled(0.0).shape)
    for layout, factor in ((middle, 2), (coarse, 4)):
        held = coarse_means(values, fine, factor)
        assert held.size == layout.filled(0.0).size
        amounts = np.sum(layout.volumes * held.reshape(layout.filled(0.0).shape))
        assert amounts == pytest.approx(np.sum(fine.volumes * values), rel=1e-12)
        # every cell lies inside each of them
        taken = layout.scatter(position, np.ones(60))
        assert np.sum(layout.volumes * taken) == pytest.approx(60.0, rel=1e-12)


def test_geometries_are_those_that_fit():
    def found(*args, **changes):
        scene = scene_with(*args, **changes)
        return geometries(scene, frame_at(scene, None, 1, print), "oxygen")

    assert found() == [CUBES, SHELLS]
    assert found({"geometry": "radial"}) == [SHELLS, CUBES]
    assert found({"sides": {"z-": {"type": "derivative", "derivative": 0}}}) == [CUBES]
    assert found(dimensions=2) == [SQUARES]
    assert found(**{"initial.count": 1}) == [CUBES]


@pytest.mark.parametrize("geometry", [CUBES, SHELLS])
def test_scales_of_time_are_the_ends_of_the_spectrum(geometry):
    problem = problem_of(scene_with(), TRANSIENT, geometry, rung=0)
    equation, shape = problem.whole, problem.start.shape

    def spectrum(at):
        n, step, columns = at.size, 1e-7, []
        for k in range(n):
            e = np.zeros(n)
            e[k] = step
            up, down = (equation.rates(at + s * e.reshape(shape), 0.0)[0] for s in (1, -1))
            columns.append((up - down).ravel() / (2.0 * step))
        return -np.linalg.eigvals(np.array(columns).T).real

    assert 2.0 / problem.limit == pytest.approx(spectrum(np.zeros(shape)).max(), rel=0.03)
    assert 1.0 / problem.slowest == pytest.approx(spectrum(problem.start).min(), rel=0.05)


def test_neighbours_are_where_rates_depend_on_nodes():
    problem = problem_of(scene_with(), TRANSIENT, rung=0)
    known = neighbours(problem.start.shape).toarray() != 0.0
    rates, n = problem.whole.rates, problem.nodes
    rest = rates(problem.start, 0.0)[0].ravel()
    for k in range(0, n, 7):
        moved = problem.start.copy()
        moved.flat[k] += 1e-3
        changed = rates(moved, 0.0)[0].ravel() != rest
        assert not (changed & ~known[:, k]).any()
        assert changed.sum() >= 4


# --- references -----------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("geometry", [CUBES, SHELLS, SQUARES])
def test_the_reference_is_known_far_better_than_solvers(kind, geometry):
    scene = scene_with(dimensions=2) if geometry == SQUARES else scene_with()
    problem = problem_of(scene, kind, geometry, rung=0)
    bench = bench_of(problem)
    exact = bench.exact
    assert exact.uncertainty < 1e-8
    assert exact.data.min() >= 0.0
    assert np.abs(exact.data - problem.start).max() > 0.03 * problem.scale
    name = "multicell-steady" if kind == STEADY else "multicell-march"
    found = bench.attempt(SOLVERS[name], 1e-3, 60.0)
    assert found.data is not None, found.words
    assert found.error < 3e-3
    assert found.attempt.steps > 0


@pytest.mark.slow
def test_all_solvers_meet_the_closed_form_of_a_medium_that_switches():
    """Stirred between walls c follows k (medium - c), whatever the grid and the cells."""
    wall = {"*": {"type": "derivative", "derivative": 0}}
    k = 0.8
    oxygen = {"uptake": 0.0, "perfusion": f"{k} 1/s", "sides": wall}
    scene = scene_with(oxygen, coupling_step="4 s")
    problem = problem_of(scene, SWITCH, rung=0)
    _, (_, begin, end) = problem.pieces
    expected = 0.07 * (0.5 + 0.5 * math.exp(-k * (end - begin)))
    bench = bench_of(problem)
    assert np.abs(bench.exact.data - expected).max() < 1e-9
    for solver in SOLVERS.values():
        if solver.refusal(problem):
            continue
        setting = 1e-5 if solver.kind == "controlled" else 0.25 * solver.stable
        found = bench.attempt(solver, setting, 60.0)
        assert found.data is not None, f"{solver.name}: {found.words}"
        assert np.abs(found.data - expected).max() < 5e-3 * 0.07, solver.name
        assert found.attempt.steps > 0, solver.name


def test_the_error_of_shells_is_that_against_the_closed_form():
    """Cells on shells are sheets: between them c is a + b/r, at each the flux falls by its uptake.

    D 4πr² dc/dr = Σ of what the cells inside take up; shooting from the middle outwards.
    """
    scene = scene_with({"geometry": "radial", "half_saturation": "0.02 mM", "uptake": "60 amol/s"})
    frame = frame_at(scene, None, 1, print)
    nutrient = scene.nutrients["oxygen"]
    layouts = grids(scene, frame, "oxygen", SHELLS, 3)
    r = np.sort(np.linalg.norm(frame.cells.position - layouts[0].centre, axis=1))
    middle = case(scene, frame, "oxygen", STEADY, layouts[1])
    capacity = middle.whole.terms["oxygen"].substance.capacity
    assert np.ptp(capacity) < 1e-12 * capacity[0]

    def outwards(inside):
        c, flux, pieces = inside, 0.0, [(0.0, inside, 0.0)]
        for k, radius in enumerate(r):
            flux += capacity[0] * c / (nutrient.half_saturation + c)
            b = -flux / (4.0 * np.pi * nutrient.diffusion)
            a = c - b / radius
            pieces.append((radius, a, b))
            beyond = r[k + 1] if k + 1 < len(r) else layouts[0].radius
            c = a + b / beyond
        return c, pieces

    inside = brentq(lambda c: outwards(c)[0] - 0.07, 1e-9, 0.07, xtol=1e-15)
    begins, a, b = (np.array(x) for x in zip(*outwards(inside)[1], strict=True))
    faces = np.linspace(0.0, layouts[0].radius, layouts[0].count + 1)
    right = []
    for low, high in itertools.pairwise(faces):
        x = np.linspace(low, high, 4001)[:-1] + (high - low) / 8000.0
        piece = np.searchsorted(begins, x, side="right") - 1
        right.append(np.average(a[piece] + b[piece] / x, weights=x**2))
    # the reference by ever finer grids leaves no more open than it says
    for k, found in enumerate(of_grids(scene, frame, "oxygen", STEADY, layouts)):
        problem = case(scene, frame, "oxygen", STEADY, layouts[k])
        steady = coarse_means(problem.whole.steady_state(problem.start, 0.0)[0], layouts[k], 2**k)
        error = np.abs(steady - np.array(right)).max() / problem.scale
        assert error > 1e-4
        assert abs(found.error - error) <= found.uncertainty
        assert found.uncertainty < 0.5 * error


@pytest.mark.parametrize("geometry", [CUBES, SHELLS])
def test_errors_of_grids_fall_with_the_square_of_the_spacing(geometry):
    scene = scene_with({"uptake": "60 amol/s"})
    frame = frame_at(scene, None, 1, print)
    layouts = grids(scene, frame, "oxygen", geometry, 3)
    errors = [found.error for found in of_grids(scene, frame, "oxygen", STEADY, layouts)]
    for coarse, fine in itertools.pairwise(errors):
        assert 2.5 < coarse / fine < 7.0


@pytest.mark.slow
def test_backends_differ_by_rounding_only():
    problem = problem_of(scene_with(), TRANSIENT, SHELLS, rung=0)
    exact = on_one_grid(problem)
    found = []
    for backend in ("kernels", "numpy", "numba"):
        bench = Bench(problem, exact, backend)
        rows, _ = bench.climb(SOLVERS["euler"], Effort(2, 60.0, 60.0, 1), lambda _: None)
        row = next(row for row in rows if row["status"] == DONE)
        assert (row["backend"], row["steps"] > 0.0) == (backend, True)
        found.append(bench.attempt(SOLVERS["euler"], 0.9, 60.0).data)
        # compilation takes seconds, and is no part of it
        assert row["cpu"] < 1.0
    np.testing.assert_allclose(found[1], found[0], rtol=1e-12)
    np.testing.assert_allclose(found[2], found[0], rtol=1e-12)


# --- failures -------------------------------------------------------------------------------------


def test_failures_are_results_of_their_kind():
    problem = problem_of(scene_with(), TRANSIENT, rung=0)
    bench = bench_of(problem)

    def kind(name, setting, patience=20.0):
        found = bench.attempt(SOLVERS[name], setting, patience)
        assert found.data is not None or found.words
        return found.kind

    assert kind("euler", 0.9) == RIGHT
    assert kind("euler", 6.0) == RUNS_AWAY
    assert kind("crank-nicolson", 8.0) == NO_CONVERGENCE
    assert kind("implicit", 0.4) == RIGHT
    assert kind("implicit", 2.0) == NO_CONVERGENCE
    assert kind("runge-kutta-adaptive", 1e-4, patience=1e-6) == TOO_SLOW
    assert kind("multicell-march", 1e-4, patience=1e-6) == TOO_SLOW
    assert kind("multicell-implicit", 1e-4, patience=1e-6) == TOO_SLOW
    assert kind("multicell-implicit", 1e-4) == RIGHT


def test_the_map_of_stability_knows_the_limits():
    problem = problem_of(scene_with(), TRANSIENT, SHELLS, rung=1)
    wanted = [SOLVERS[name] for name in ("euler", "crank-nicolson", "multicell-implicit")]
    rows = stability_rows(
        problem, wanted, "kernels", 20.0, lambda _: None, uptakes=(1.0, 1000.0),
        steps=(0.25, 4.0), tolerances=(1e-3,),
    )  # fmt: skip
    kinds = {(r["solver"], r["factor"], r["setting"]): r["kind"] for r in rows}
    assert kinds["euler", 1.0, 0.25] == RIGHT
    assert kinds["euler", 1.0, 4.0] == RUNS_AWAY
    assert kinds["crank-nicolson", 1.0, 0.25] == RIGHT
    assert kinds["crank-nicolson", 1000.0, 4.0] == NO_CONVERGENCE
    assert kinds["multicell-implicit", 1.0, 1e-3] == RIGHT
    assert kinds["multicell-implicit", 1000.0, 1e-3] == RIGHT
    weak, strong = (next(r for r in rows if r["factor"] == f) for f in (1.0, 1000.0))
    assert strong["thiele"] == pytest.approx(math.sqrt(1000.0) * weak["thiele"], rel=1e-9)
    assert strong["limit"] < 0.1 < weak["limit"] <= 1.0
    assert 2.0 / fastest_rate(problem.whole, problem.scale, problem.start) == problem.limit


# --- the whole ------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_comparison_is_written_read_and_reported(tmp_path, monkeypatch):
    monkeypatch.setattr(measure, "UPTAKES", (1.0, 30.0))
    monkeypatch.setattr(measure, "STEPS", (0.5, 4.0))
    monkeypatch.setattr(measure, "TOLERANCES", (1e-3, 1e-2))
    names = ["multicell-steady", "multicell-implicit", "euler", "crank-nicolson", "scipy-BDF"]
    result = mc.compare_fields(
        scene_with(coupling_step="2 s"), tmp_path / "out", solvers=names, spacings=1, repeats=1,
        budget=8.0,
    )  # fmt: skip
    files = {path.name for path in (tmp_path / "out").iterdir()}
    assert files == {
        "field-solvers.csv", "field-grids.csv", "field-stability.csv", "field-solvers.json",
        "field-solvers.png", "field-spacings.png", "field-stability.png", "report.html",
    }  # fmt: skip
    assert {row["problem"] for row in result.table} == set(KINDS)
    assert {row["geometry"] for row in result.table} == {CUBES, SHELLS}
    assert result.solvers == names
    for row in result.table:
        assert (row["status"] == DONE) == (row["kind"] == RIGHT)
        if row["status"] == DONE:
            assert 0.0 < row["cpu_shortest"] <= row["cpu"]
        if row["status"] == FAILED:
            assert row["words"]
        assert row["uncertainty"] < 1e-7
    best = result.cheapest(1e-3, problem=STEADY, geometry=CUBES)
    assert best["solver"] == "multicell-steady"
    document = tmp_path / "out" / "field-solvers.json"
    again = mc.FieldComparison.read(document)
    assert mc.FieldComparison.from_json(document.read_text()).text() == result.text()
    assert again.text() == result.text()
    assert json.loads(again.to_json()) == json.loads(result.to_json())
    assert "within 0.1 %: multicell-steady" in result.text()
    assert "does not converge: crank-nicolson" in result.text()
    assert "Note: crank-nicolson: py-pde judges the iteration in a loop" in result.text()
    for figure in (result.figure(), result.spacings_figure(), result.stability_figure()):
        assert figure.axes
    panels = [axes for axes in result.figure().axes if not axes.get_label().endswith(" x")]
    assert len(panels) == 6
    for axes in panels:
        assert axes.get_window_extent().width == pytest.approx(axes.get_window_extent().height)


def test_pictures_of_an_earlier_comparison_do_not_stay(tmp_path):
    folder = tmp_path / "out"
    folder.mkdir()
    for name in ("field-solvers-2.png", "field-stability.csv", "notes.txt"):
        (folder / name).write_text("old")
    mc.compare_fields(
        scene_with(coupling_step="2 s"), folder, solvers=["multicell-steady"], spacings=1,
        repeats=1, stability=False, overwrite=True,
    )  # fmt: skip
    left = {path.name for path in folder.iterdir()}
    assert {"notes.txt", "field-solvers.png"} <= left
    assert not left & {"field-solvers-2.png", "field-stability.csv"}


def test_what_cannot_be_compared_is_said(tmp_path):
    scene = scene_with()
    without = mc.load_scene("settle").with_changes({"initial.count": 3})
    with pytest.raises(mc.SceneError, match="nutrients: are none"):
        mc.compare_fields(without)
    for words, wrong in {
        "solvers: has 'euller', which is no solver of fields. Did you mean 'euler'": {
            "solvers": ["euller"]
        },
        r"solvers: is \[\], expected a list": {"solvers": []},
        "fields: has 'sugar', which is no field of the scene": {"fields": ["sugar"]},
        "clock: is 'sand'": {"clock": "sand"},
        "backend: is 'torch'": {"backend": "torch"},
        "spacings: is 0": {"spacings": 0},
        "at: is 7200 s, after the end of the scene": {"at": "2 h"},
        "at: is '-1 s', must be a time": {"at": "-1 s"},
    }.items():
        with pytest.raises(mc.SceneError, match=words):
            mc.compare_fields(scene, tmp_path / "out", **wrong)
    assert not (tmp_path / "out").exists()
    silent = scene_with({"boundary": 0.0, "uptake": 0.0})
    with pytest.raises(mc.SceneError, match="is zero everywhere"):
        mc.compare_fields(silent, spacings=1)


def test_a_medium_that_reaches_nothing_has_no_switch_and_that_is_noted():
    side = {"*": {"type": "value", "value": "0.07 mM"}}
    scene = scene_with({"sides": side})
    result = mc.compare_fields(
        scene, solvers=["multicell-implicit"], spacings=1, repeats=1, stability=False
    )
    assert {row["problem"] for row in result.table} == {STEADY, TRANSIENT}
    assert any("does not feel its medium" in note for note in result.facts["notes"])
    with pytest.raises(ValueError, match="without a stability map"):
        result.stability_figure()
