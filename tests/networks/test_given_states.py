"""States of networks in what runs start with, in daughters, and in what shows the cells."""

from __future__ import annotations

import numpy as np
import pytest
from stored import assert_same_bits

import multicell as mc
from multicell.errors import DataError, SceneError
from multicell.networks.custom import network
from multicell.report.viewer.pack import pack_frames

GROWING = {"duration": "3 h", "initial.count": 12, "initial.stage": "uniform",
           "output.every": "1 h", "growth.cycle_time": "4 h"}  # fmt: skip


@network(states={"HIF1": 0.1, "mRNA": 1.0}, inputs={"source": 0.0}, parameters={"k": 2e-4})
def kept(t, y, u, p, out):
    """One state that follows an input, and one that nothing changes."""
    out[0] = p[0] * (u[0] - y[0])
    out[1] = 0.0


@network(states={"X": 1.0})
def other(t, y, u, p, out):
    out[0] = 0.0


def _scene(own=kept, **changes):
    part = {"network": own, "dilution": False}
    if own is kept:
        part["inputs"] = {"source": "time"}
    return mc.load_scene("growth").with_changes(
        {**GROWING, "networks": {"hif": part}, **changes}
    )  # fmt: skip


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run") / "out"
    return mc.run(_scene(), output=folder, threads=1, report=False)


def _states(simulation, ids):
    return simulation.cells.inside[simulation.cells.rows_of(ids), :2]


def _again(**changes):
    return _scene(**{"initial": {}, **changes})


def test_a_run_starts_with_the_states_of_a_table(run, tmp_path):
    frame = run.frames[-1]
    want = np.stack([frame.inside["hif.HIF1"], frame.inside["hif.mRNA"]], axis=1)
    table = frame.to_pandas()
    table.to_csv(tmp_path / "cells.csv", index=False)
    scene = _scene().with_changes({"initial": {"cells": str(tmp_path / "cells.csv")}})
    starts = [
        mc.Simulation(scene, threads=1),
        mc.Simulation(_again(), cells=frame.cells, threads=1),
        mc.Simulation(_again(), cells=table, threads=1),
    ]
    for simulation in starts:
        assert simulation.plan.networks.columns[:2] == ("hif.HIF1", "hif.mRNA")
        np.testing.assert_array_equal(_states(simulation, frame.cells.id), want)


def test_states_that_differ_are_those_of_their_rows_whatever_the_order(run):
    table = run.frames[0].to_pandas().sample(frac=1.0, random_state=3)
    table["hif.mRNA"] = 10.0 + table["id"]
    table.loc[table.index[:3], "hif.HIF1"] = np.nan  # these begin as the network states
    simulation = mc.Simulation(_again(), cells=table, threads=1)
    found = _states(simulation, table["id"].to_numpy())
    np.testing.assert_array_equal(found[:, 1], 10.0 + table["id"])
    np.testing.assert_array_equal(found[:3, 0], 0.1)
    # daughters have what their mothers had
    while not simulation.finished:
        simulation.step()
    cells = simulation.cells
    born = cells.parent >= 0
    assert born.any()
    own = simulation.cells.inside[:, 1]
    np.testing.assert_allclose(own[~born], 10.0 + cells.id[~born])
    assert set(np.round(own[born] - 10.0)) <= set(table["id"])


def test_a_run_from_a_table_with_states_is_resumed_with_the_same_bits(run, tmp_path):
    cells = run.frames[-1].cells
    whole = mc.run(_again(), cells=cells, output=tmp_path / "whole", threads=1, report=False)
    again = mc.resume(whole.folder, 1, output=tmp_path / "again", threads=1, report=False)
    assert_same_bits(whole.folder, again.folder)
    assert (whole.folder / "cells.csv").is_file()
    first = whole.frames[0]
    rows = first.cells.rows_of(cells.id)
    np.testing.assert_array_equal(first.inside["hif.HIF1"][rows], cells.inside[:, 0])


def test_values_of_networks_that_do_not_fit_are_refused(run):
    table = run.frames[0].to_pandas()
    with pytest.raises(DataError, match=r"hif\.HIF2.*no value of a network.*hif\.HIF1"):
        mc.run(_again(), cells=table.assign(**{"hif.HIF2": 1.0}))
    with pytest.raises(DataError, match="The scene has no networks"):
        mc.run(_again(networks={}), cells=table)
    with pytest.raises(DataError, match="must be a finite number"):
        mc.run(_again(), cells=table.assign(**{"hif.HIF1": np.inf}))
    typed = _again(types={"a": {}, "b": {}}).with_changes({"networks.hif.cells": "b"})
    kinds = ["a", "b"] * (len(table) // 2)
    with pytest.raises(DataError, match="cells of this type have no network 'hif'"):
        mc.run(typed, cells=table.assign(kind=kinds))
    with pytest.raises(SceneError, match="networks that are not those of this scene"):
        mc.run(_scene(other, initial={}), cells=run.frames[0].cells)


def test_the_view_has_states_and_says_where_there_are_none(tmp_path):
    scene = _scene(types={"a": {}, "b": {}}, duration="1 h")
    run = mc.run(
        scene.with_changes({"networks.hif.cells": "a"}),
        output=tmp_path / "out",
        threads=1,
        report=False,
    )
    about = pack_frames(run).about
    (column,) = (one for one in about["columns"] if one["name"] == "hif.HIF1")
    (shades,) = (one for one in about["colourings"] if one["name"] == "hif.HIF1")
    values = np.concatenate([frame.inside["hif.HIF1"] for frame in run.frames])
    assert column["gaps"]
    assert column["label"] == "hif.HIF1"
    step = (column["high"] - column["low"]) / column["top"]
    assert column["low"] + step == pytest.approx(np.nanmin(values))
    assert column["high"] == pytest.approx(np.nanmax(values))
    assert shades["low"] >= np.nanmin(values)
    whole = mc.run(scene, output=tmp_path / "whole", threads=1, report=False)
    whole = pack_frames(whole).about
    (column,) = (one for one in whole["columns"] if one["name"] == "hif.HIF1")
    assert "gaps" not in column


@pytest.mark.slow
def test_pictures_are_coloured_by_a_state(run, tmp_path):
    from multicell.report.plots.movie import movie

    figure = run.plot.section(colour="hif.HIF1")
    assert "hif.HIF1" in {axes.get_title() for axes in figure.axes} | {
        text.get_text() for axes in (*figure.axes, figure) for text in axes.texts
    } | {axes.get_ylabel() for axes in figure.axes}  # fmt: skip
    run.plot.space(colour="hif.mRNA")
    movie(run, tmp_path / "moving.gif", colour="hif.HIF1")
    assert (tmp_path / "moving.gif").stat().st_size > 1000
