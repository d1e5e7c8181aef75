"""Runs in space that repeats: cells that cross borders, fields, observables, pictures, refusals."""

import numpy as np
import pytest
from running import finished, refused
from synthetic import cells_at

import multicell as mc
from multicell.errors import DataError
from multicell.results.frame import Frame
from multicell.results.observables import touching
from multicell.scene.scene import Scene
from multicell.scene.start_checks import deep_overlaps
from multicell.simulation import Simulation
from multicell.vectors import wrapped

BOX = {"x": ["-20 um", "20 um"], "y": ["-22 um", "22 um"], "z": ["-30 um", "30 um"]}


def scene_of(periodic="xy", **parts):
    return Scene.from_dict({
        "duration": "2 h", "coupling_step": "10 min", "initial": {"count": 20},
        "cells": {"young_variation": 0}, "domain": {**BOX, "periodic": list(periodic)}, **parts,
    })  # fmt: skip


def test_cells_that_all_go_one_way_come_back_unwrapped():
    motility = {"force": "40 nN", "bias": 1.0, "direction": [1, 0.5, 0]}
    run = Simulation(scene_of(motility=motility, duration="6 h"))
    start = run.cells.position[np.argsort(run.cells.id)]
    away = np.linalg.norm(start[:, None] - start, axis=-1)
    finished(run)
    cells = run.cells
    moved = cells.position[np.argsort(cells.id)] - start
    speed = 40.0 / (6 * np.pi * 5.0 * cells.radius[0]) / np.hypot(1.0, 0.5)
    np.testing.assert_allclose(moved.mean(axis=0), 6 * 3600 * speed * np.array([1, 0.5, 0]),
                               rtol=1e-9, atol=1e-9)  # fmt: skip
    assert moved[:, 0].min() > 200.0
    after = np.linalg.norm(cells.position[:, None] - cells.position, axis=-1)
    assert after.max() == pytest.approx(away.max(), rel=0.3)
    inside = run.frame().within(run.scene.domain).cells.position
    assert (np.abs(inside) <= [20, 22, 30]).all()
    turns = (cells.position - inside) / [40, 44, 1]
    np.testing.assert_allclose(turns, np.rint(turns), atol=1e-9)


def test_tissue_without_edges_has_uniform_neighbours():
    """A lattice that fills the box: each cell is in contact with six others, over borders too."""
    grid = np.stack(np.meshgrid(*[np.arange(k) for k in (5, 5, 5)]), axis=-1).reshape(-1, 3)
    size = 7.5
    box = {axis: [-3.0, 5 * size - 3.0] for axis in "xyz"} | {"periodic": ["x", "y", "z"]}
    place = grid * size - 3.0
    scene = scene_of(domain=box, types={"a": {}, "b": {}}, duration="20 min")
    table = {f"{axis}_um": place[:, k] for k, axis in enumerate("xyz")}
    run = Simulation(scene, cells={**table, "type": np.array(["a"] * 125)})
    assert len(run.state.contacts) == 3 * 125
    finished(run)
    assert len(run.state.contacts) == 3 * 125
    np.testing.assert_allclose(run.cells.position[np.argsort(run.cells.id)], place, atol=1e-9)
    frame = run.frame()
    period = scene.domain.period
    np.testing.assert_array_equal(touching(frame, period), np.sort(touching(frame, period), axis=1))
    assert len(touching(Frame(0.0, 0, frame.cells), period)) == 3 * 125


def test_a_growing_field_scene_keeps_its_account():
    field = {"boundary": "0.2 mM", "uptake": "20 amol/s", "spacing": "10 um", "regime": "transient"}
    scene = scene_of(
        growth={"cycle_time": "5 h"}, nutrients={"oxygen": field}, duration="12 h",
        domain={**BOX, "z": ["-20 um", "20 um"], "y": ["-20 um", "20 um"], "periodic": ["x", "y"]},
    )  # fmt: skip
    run = finished(scene)
    assert len(run.cells) > 3 * 20
    assert abs(run.summary()["ledger"]["relative_remainder"]) < 1e-9
    inside = run.fields["oxygen"]
    assert inside.repeats == (True, True, False)
    assert list(inside.to_pde().grid.periodic) == [True, True, False]
    # by whole periods away cells find the same
    cells, there = run.cells, run._run.field_system.fields["oxygen"]
    found = there.sample(cells.position, cells.radius)
    away = there.sample(cells.position + np.array([40.0, -80.0, 0.0]), cells.radius)
    np.testing.assert_allclose(away, found, rtol=1e-12)


def test_a_steady_field_is_that_of_a_longer_box():
    """A source in a period of 40 µm between two reservoirs, and in five periods."""
    field = {"boundary": "0 mM", "secretion": "5 amol/s", "uptake": 0, "spacing": "5 um",
             "regime": "steady", "diffusion": "50 um^2/s"}  # fmt: skip
    box = {axis: [-20, 20] for axis in "xyz"} | {"periodic": ["x"]}
    one = scene_of("x", nutrients={"signal": field}, initial={"count": 1}, domain=box)
    walls = {"x": {"type": "derivative", "derivative": 0.0}}
    five = scene_of("", nutrients={"signal": {**field, "sides": walls}},
                    domain={"x": [-100, 100], "y": [-20, 20], "z": [-20, 20]})  # fmt: skip
    row = {"x_um": 40.0 * np.arange(-2, 3) + 17.0, "y_um": np.zeros(5), "z_um": np.zeros(5)}
    short = Simulation(one, cells={name: column[2:3] for name, column in row.items()})
    long = Simulation(five, cells=row)
    found = short.fields["signal"].values
    # mirrors of the long box stand where periods do not: its middle is far from them
    exact = long.fields["signal"].values[16:24]
    np.testing.assert_allclose(found, exact, rtol=5e-4)


def test_lengths_that_need_a_centre_do_not_exist():
    run = finished(scene_of("xyz", duration="30 min", growth={}))
    summary = run.summary()
    for name in ("diameter", "radius", "viable_rim", "necrotic_radius", "packing_ratio"):
        assert summary[name] is None
    volume = run.cells.volume.sum() / (40 * 44 * 60)
    assert summary["volume_fraction"] == pytest.approx(volume)
    pressure = run.cells.pressure @ run.cells.volume / (40 * 44 * 60)
    assert summary["tissue_pressure"] == pytest.approx(pressure)
    assert "wall_pressure" not in summary


def test_contacts_of_cells_that_rounding_puts_below_zero():
    """A whole number of periods away an image may be below zero by rounding: no search takes it."""
    edges = [side * k * 40.0 for k in range(1, 60) for side in (1, -1)]
    x = np.array([np.nextafter(edge, 0.0) for edge in edges])
    nothing = np.zeros(len(x))
    place = np.stack([x, 30.0 * np.arange(len(x)), nothing], axis=1)
    period = np.array([40.0, 0.0, 0.0])
    inside = wrapped(place, period)
    assert inside[:, 0].min() >= 0.0
    assert inside[:, 0].max() < 40.0
    near = np.concatenate([place, place + np.array([3.0, 0.0, 0.0])])
    found = touching(Frame(0.0, 0, cells_at(near, 4.0)), period)
    np.testing.assert_array_equal(found, np.arange(len(x))[:, None] + [0, len(x)])


@pytest.mark.parametrize("other", [20.0, 20.0 - 1e-12, -60.0, 60.0 + 1e-10])
def test_cells_at_one_place_over_the_border_are_refused(other):
    """As a lattice with both ends of the box has them."""
    table = {"x_um": [-20.0, 0.0, other], "y_um": [1.0, 1.0, 45.0], "z_um": [0.0, 0.0, 0.0]}
    with pytest.raises(DataError, match=r"row 2.*is at the place of row 0"):
        Simulation(scene_of(), cells=table)
    # walls stand there: these are two cells
    walled = {**table, "x_um": [-20.0, 0.0, 19.0], "y_um": [1.0, 1.0, 1.0]}
    assert len(Simulation(scene_of("y"), cells=walled).cells) == 3


def test_deep_overlaps_over_the_border_are_counted():
    table = {"x_um": [-19.5, 19.5, 0.0], "y_um": [0.0] * 3, "z_um": [0.0] * 3}
    for periodic, pairs in (("xy", 1), ("y", 0)):
        scene = Simulation(scene_of(periodic), cells=table).scene
        assert deep_overlaps(scene) == pairs


@pytest.mark.slow
def test_a_result_can_be_drawn_and_exported(tmp_path):
    pytest.importorskip("matplotlib")
    scene = scene_of("xyz", motility={"force": "40 nN"}, duration="6 h", types={"a": {}, "b": {}})
    result = mc.run(scene, output=tmp_path / "run")
    assert (tmp_path / "run" / "report.html").exists()
    assert {"section.png", "contacts.png"} <= {p.name for p in (tmp_path / "run").iterdir()}
    assert not (tmp_path / "run" / "profiles.png").exists()
    with pytest.raises(ValueError, match="there is no centre"):
        result.plot.profiles()
    low, high = result.plot.section().axes[0].get_xlim()
    assert high - low < 130.0


@pytest.mark.parametrize(("path", "words", "parts"), [
    ("domain.x", "must be at least 20 um to repeat", {"domain": {**BOX, "x": [0, 19.9]}}),
    ("domain.periodic", "which 2 dimensions do not have", {
        "dimensions": 2, "domain": {"x": [0, 40], "y": [0, 40], "periodic": ["z"]}}),
    ("domain.periodic", "names 'x' twice", {"domain": {**BOX, "periodic": ["x", "y", "x"]}}),
    ("pull", "neither centre nor rim", {"pull": {"force": 1.0}}),
    ("surface", "neither centre nor rim", {"surface": {"tension": 0.1}}),
    ("compression", "between walls", {"compression": {}}),
    ("domain.periodic", "has no meaning where shape = 'sphere'", {
        "domain": {"shape": "sphere", "radius": 100, "periodic": ["x"]}}),
    ("nutrients.oxygen.sides.x-", "space repeats along x", {
        "nutrients": {"oxygen": {"boundary": 0.1, "sides": {"x-": {"type": "value"}}}}}),
    ("nutrients.oxygen.sides", "fix no level", {
        "domain": {**BOX, "periodic": ["x", "y", "z"]},
        "nutrients": {"oxygen": {"boundary": 0.1, "regime": "steady"}}}),
    ("nutrients.oxygen.finite_medium", "touches no side", {
        "domain": {**BOX, "periodic": ["x", "y", "z"]},
        "nutrients": {"oxygen": {"boundary": 0.1, "finite_medium": {"volume": 1e8}}}}),
])  # fmt: skip
def test_refusals(path, words, parts):
    domain = {"periodic": ["x", "y"], **parts.pop("domain", BOX)}
    with refused(path, words):
        scene_of(**{**parts, "domain": domain})


def test_a_scene_is_read_back_and_explained(tmp_path):
    from multicell.report.explain.scene import explain

    scene = scene_of()
    (tmp_path / "scene.toml").write_text(scene.to_toml())
    assert mc.load_scene(tmp_path / "scene.toml") == scene
    assert "space repeats along x and y" in str(explain(scene))
    assert "there are no walls" in str(explain(scene_of("xyz")))
