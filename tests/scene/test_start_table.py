# ruff: noqa: E501 - tables and what is said of them stand on one line
"""Cells to start with from a table: what is read, what is drawn, what is refused and where."""

from __future__ import annotations

import copy
import io
import pickle
import shutil
from decimal import Decimal

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from stored import assert_same_bits

import multicell as mc
from multicell.biology.initial import initial_cells
from multicell.cells import Phase, State
from multicell.cli.main import main
from multicell.errors import DataError, SceneError
from multicell.report.explain.scene import explain
from multicell.scene.start_table import normalise, with_cells
from multicell.studies.runs import run_digest
from multicell.tables.columns import from_bytes, from_object

PLACES = "x_um,y_um,z_um\n0,0,0\n9,0,0\n0,9,0\n0,0,9\n"
PHASES = {
    name: {"duration": "5 h", "distribution": "gamma", "grows": name != "M"}
    for name in ("G1", "S", "G2", "M")
}
TYPES = {"soft": {"fraction": 1.0}, "stiff": {"fraction": 3.0, "young": "2 kPa"}}


def written(folder, text, **scene):
    """Write a table and a scene that starts with it; return the path of the scene."""
    (folder / "mine.csv").write_text(text, encoding="utf-8")
    lines = mc.Scene.from_dict({"duration": 3600.0, **scene}).to_toml()
    head, tail = lines.split("[initial]\n")
    stage = next(line for line in tail.splitlines() if line.startswith("stage"))
    rest = tail[tail.index("\n[") :]
    file = folder / "scene.toml"
    file.write_text(f'{head}[initial]\ncells = "mine.csv"\n{stage}\n{rest}', encoding="utf-8")
    return file


def start(folder, text, **scene):
    return initial_cells(mc.load_scene(written(folder, text, **scene)))


def refused(folder, text, **scene):
    with pytest.raises(DataError) as caught:
        mc.load_scene(written(folder, text, **scene))
    return str(caught.value)


def test_positions_are_enough_and_the_rest_is_drawn_as_for_cells_that_are_arranged(tmp_path):
    scene = {"growth": {}, "types": TYPES, "initial": {"stage": "asynchronous"}, "seed": 5}
    cells = start(tmp_path, PLACES, **scene)
    drawn = initial_cells(
        mc.Scene.from_dict({"duration": 1, **scene, "initial": {"count": 4, **scene["initial"]}})
    )
    assert cells.position.tolist() == [[0, 0, 0], [9, 0, 0], [0, 9, 0], [0, 0, 9]]
    for name, column in cells.columns():
        if name != "position":
            np.testing.assert_array_equal(column, getattr(drawn, name), err_msg=name)


def test_units_types_and_names_are_read(tmp_path):
    text = (
        "# from a microscope\ntype, x_mm, y / nm, position_z_um, radius (um), state, age_h, id\n"
        "stiff, 0.01, 2000, -3, 4.5, quiescent, 2, 70\n\nsoft, 0, 0, 0, 4, necrotic, 5, 8\n"
    )
    cells = start(tmp_path, text, growth={}, types=TYPES)
    np.testing.assert_allclose(cells.position, [[10.0, 2.0, -3.0], [0, 0, 0]], rtol=1e-15)
    assert cells.radius.tolist() == [4.5, 4.0]
    assert cells.kind.tolist() == [1, 0]
    assert cells.state.tolist() == [State.QUIESCENT, State.NECROTIC]
    assert cells.age.tolist() == [7200.0, 18000.0]
    assert cells.id.tolist() == [70, 8]
    assert cells.parent.tolist() == [-1, -1]


def test_radius_age_and_cycle_follow_from_each_other(tmp_path):
    born = 5.0 / np.cbrt(2.0)
    sized = PLACES.replace("z_um\n", "z_um,radius_um\n").replace("0\n", f"0,{born * 1.1}\n", 1)
    sized = sized.replace("9,0,0\n", "9,0,0,5\n").replace("0,9,0\n", "0,9,0,4\n")
    sized = sized.replace("0,0,9\n", "0,0,9,3\n")
    cells = start(tmp_path, sized, growth={"cycle_variation": 0.0})
    share = np.clip(2.0 * (cells.radius / 5.0) ** 3 - 1.0, 0.0, 1.0)
    np.testing.assert_allclose(cells.age, share * 54000.0, rtol=1e-12)
    aged = "x_um,y_um,z_um,age_h,cycle_time_h\n0,0,0,5,10\n9,0,0,0,20\n"
    cells = start(tmp_path, aged, growth={})
    np.testing.assert_allclose(cells.volume / cells.volume[1], [1.5, 1.0], rtol=1e-12)
    assert cells.cycle_time.tolist() == [36000.0, 72000.0]


@pytest.mark.parametrize("law", ["linear", "exponential", "relaxation"])
@pytest.mark.parametrize("phases", [False, True], ids=["", "phases"])
def test_size_alone_tells_age_and_phase(law, phases):
    growth = {"law": law, "cycle_variation": 0.0}
    if law == "relaxation":
        growth["parameters"] = {"target": 1.3}
    if phases:
        growth["phases"] = {name: {**phase, "grows": True} for name, phase in PHASES.items()}
    entries = {"duration": 1, "growth": growth, "initial": {"count": 40, "stage": "uniform"}}
    scene = mc.Scene.from_dict(entries)
    cells = initial_cells(scene)
    sized = dict(zip(("x_um", "y_um", "z_um"), cells.position.T, strict=True))
    found = initial_cells(with_cells(scene, {**sized, "radius_um": cells.radius}))
    for name in ("phase", "progress", "phase_length", "cycle_time", "age"):
        np.testing.assert_allclose(
            getattr(found, name), getattr(cells, name), rtol=1e-9, atol=1e-6, err_msg=name
        )


def test_phases_place_cells_in_their_cycle(tmp_path):
    text = "x_um,y_um,z_um,phase\n0,0,0,G1\n9,0,0,S\n0,9,0,M\n0,0,9,G0\n"
    cells = start(tmp_path, text, growth={"phases": PHASES})
    assert [Phase(p).name for p in cells.phase] == ["G1", "S", "M", "G0"]
    assert cells.state.tolist() == [0, 0, 0, State.QUIESCENT]
    assert cells.progress.tolist() == [0.0] * 4
    born = 4.0 * np.pi / 3.0 * 62.5
    # G0 is the end of G1, where S begins; nothing grows in M
    assert cells.volume[0] == pytest.approx(born)
    assert cells.volume[2] == pytest.approx(2.0 * born)
    assert born < cells.volume[1] < 2.0 * born
    np.testing.assert_array_less(0.0, cells.phase_length[:3])


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("spheroid", {"initial.count": 40, "duration": "10 h", "growth.cycle_time": "9 h"}),
        ("sorting", {"initial.count": 40, "duration": "1 h"}),
        ("growth", {"growth.phases": PHASES, "initial.count": 12, "duration": "14 h"}),
    ],
    ids=["nutrient", "types", "phases"],
)
def test_an_exported_frame_is_a_start(name, changes, tmp_path):
    scene = mc.load_scene(name).with_changes(changes)
    run = mc.run(scene, threads=1)
    mc.export(run, tmp_path, tables=["cells"], frame=-1)
    last = run.frames[-1].cells
    sources = [
        tmp_path / "cells.csv",
        pd.read_csv(tmp_path / "cells.csv", float_precision="round_trip"),
        last,
    ]
    for source in sources:
        cells = initial_cells(with_cells(scene, source))
        for column, values in last.columns():
            if column not in ("parent", "receptor", "ligand"):
                np.testing.assert_array_equal(getattr(cells, column), values, err_msg=column)
    assert (cells.parent == -1).all()
    again = mc.Simulation(scene, cells=run.frames[-1].to_pandas())
    assert set(again.lineage.table()["parent"]) == {-1}
    again.step()


REFUSED = {
    "unknown column": ("x_um,y_um,z_um,radus_um\n0,0,0,4\n", "mine.csv, 'radus_um': is not a known column here. Did you mean 'radius_um'?"),
    "no unit": ("x,y_um,z_um\n0,0,0\n", "mine.csv, 'x': has no unit. Title it 'x_um'"),
    "wrong unit": ("x_s,y_um,z_um\n0,0,0\n", "mine.csv, 'x_s': has the unit 's', must be one like um"),
    "no y": ("x_um,z_um\n0,0\n", "mine.csv: has no column for y. Columns are titled with their units, as 'position_y_um'"),
    "no z": ("x_um,y_um\n0,0\n", "mine.csv: has no column for z"),
    "negative radius": ("x_um,y_um,z_um,radius_um\n0,0,0,4\n9,0,0,-4\n", "mine.csv, line 3, 'radius_um': is -4, must be above 0"),
    "large radius": ("x_um,y_um,z_um,radius_um\n0,0,0,4\n\n9,0,0,5.1\n", "mine.csv, line 4, 'radius_um': is 5.1, beyond the radius of a dividing cell, 5 um. Set cells.division_radius"),
    "giant radius": ("x_um,y_um,z_um,radius_um\n0,0,0,4\n99,0,0,9000\n", "mine.csv, line 3, 'radius_um': is 9000, beyond the radius of a dividing cell, 5 um. Set cells.division_radius"),
    "type": ("x_um,y_um,z_um,type\n0,0,0,soft\n9,0,0,sofd\n", "mine.csv, line 3, 'type': is 'sofd', no type of this scene. Did you mean 'soft'?"),
    "state": ("x_um,y_um,z_um,state\n0,0,0,dead\n", "mine.csv, line 2, 'state': is 'dead', no state. "),
    "phase": ("x_um,y_um,z_um,phase\n0,0,0,g1\n", "mine.csv, line 2, 'phase': is 'g1', no phase. Did you mean 'G1'?"),
    "no phases": ("x_um,y_um,z_um,phase\n0,0,0,G1\n", "mine.csv, line 2, 'phase': is 'G1', but the scene has no phases"),
    "same place": ("x_um,y_um,z_um\n0,0,0\n9,0,0\n\n9,0,0\n", "mine.csv, line 5, 'x_um': is at the place of line 3: their centres coincide"),
    "same id": ("x_um,y_um,z_um,id\n0,0,0,3\n9,0,0,3\n", "mine.csv, line 3, 'id': is 3, which another row has too"),
    "broken id": ("x_um,y_um,z_um,id\n0,0,0,1.5\n", "mine.csv, line 2, 'id': is 1.5, must be a whole number from 0"),
    "age": ("x_um,y_um,z_um,age_d\n0,0,0,-1\n", "mine.csv, line 2, 'age_d': is -1, must not be negative"),
    "poisson": ("x_um,y_um,z_um,poisson\n0,0,0,0.6\n", "mine.csv, line 2, 'poisson': is 0.6, must be above -1 and at most 0.5"),
    "frames": ("frame,x_um,y_um,z_um\n0,0,0,0\n1,0,0,0\n", "mine.csv, 'frame': holds 2 frames, but a run starts with one"),
    "nothing": ("", "mine.csv: holds no data"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_a_start_is_refused_by_row_and_column(case, tmp_path):
    text, said = REFUSED[case]
    found = refused(tmp_path, text, types=TYPES)
    assert said in found


@pytest.mark.parametrize(
    ("text", "scene", "said"),
    [
        ("x_um,y_um,z_um\n0,0,2\n", {"dimensions": 2}, "line 2, 'z_um': is 2, but the scene has 2"),
        (
            "x_um,y_um,z_um\n0,0,0\n60,0,0\n",
            {"domain": {a: [-50, 50] for a in "xyz"}},
            "line 3, 'x_um': is 60 um, outside the domain: beyond its side x+",
        ),
        (
            "x_um,y_um,z_um,phase,state\n0,0,0,G0,proliferating\n9,0,0,G1,quiescent\n",
            {"growth": {"phases": PHASES}},
            "line 2, 'phase': is 'G0', but the cell proliferates. Cells in G0 are quiescent",
        ),
        (
            "x_um,y_um,z_um,progress_h\n0,0,0,5\n",
            {"growth": {"phases": PHASES}},
            "'progress_h': has no meaning without a column 'phase'",
        ),
        (
            "x_um,y_um,z_um,phase,progress_h,phase_length_h\n0,0,0,S,5,4\n",
            {"growth": {"phases": PHASES}},
            "line 2, 'progress_h': is 5, more than the length of the phase",
        ),
        ("x_um,y_um,z_um,type\n0,0,0,soft\n", {}, "is 'soft', no type of this scene. It has no"),
        (
            "x_um,y_um,z_um,cycle_time_s\n0,0,0,inf\n",
            {"growth": {}},
            "line 2, 'cycle_time_s': is inf, but the cells of this scene grow",
        ),
    ],
)
def test_what_does_not_fit_to_the_scene_is_refused_by_row_and_column(text, scene, said, tmp_path):
    assert said in refused(tmp_path, text, **scene)


def test_ages_beyond_the_cycle_are_refused_where_they_would_tell_the_size(tmp_path):
    text = "x_um,y_um,z_um,age_h\n0,0,0,5\n9,0,0,50\n"
    with pytest.raises(DataError, match=r"line 3, 'age_h': is 50, beyond the cycle time"):
        start(tmp_path, text, growth={})
    sized = "x_um,y_um,z_um,age_h,radius_um\n0,0,0,5,4\n9,0,0,50,4.2\n"
    assert start(tmp_path, sized, growth={}).age.tolist() == [18000.0, 180000.0]


def test_keys_beside_a_table_are_refused_by_name(tmp_path):
    written(tmp_path, PLACES)
    cells = str(tmp_path / "mine.csv")
    for key, value, said in (
        ("count", 5, "initial.count: is 5, but the table of initial.cells has 4 rows"),
        ("spacing", 2.0, "initial.spacing: has no effect: initial.cells gives the positions"),
        ("jitter", 0.1, "initial.jitter: has no effect"),
        ("shape", "row", "initial.shape: has no effect"),
    ):
        with pytest.raises(SceneError, match=said):
            mc.Scene.from_dict({"duration": 1, "initial": {"cells": cells, key: value}})
    assert mc.Scene.from_dict({"duration": 1, "initial": {"cells": cells, "count": 4}})


@pytest.mark.parametrize(
    ("cells", "said"),
    [
        ("nowhere.csv", "initial.cells.file: '.*nowhere.csv' does not exist. Relative paths count"),
        (".", "initial.cells.file: '.*' cannot be read: Is a directory"),
        ({"file": ""}, "initial.cells.file: is empty"),
        ({"sha256": "0"}, "initial.cells.file: is missing"),
        (5, "initial.cells: is 5, must be a table"),
        ({"file": "a\0b"}, "initial.cells.file: is 'a.x00b', must be the path of a file"),
    ],
)
def test_files_that_are_none_are_refused_by_name(cells, said):
    with pytest.raises(SceneError, match=said):
        mc.Scene.from_dict({"duration": 1, "initial": {"cells": cells}})


def test_a_file_that_has_changed_is_refused(tmp_path):
    file = written(tmp_path, PLACES)
    known = mc.load_scene(file).to_dict()
    (tmp_path / "mine.csv").write_text(PLACES.replace("9", "8"), encoding="utf-8")
    stale = mc.Scene.from_dict(known)
    with pytest.raises(SceneError, match=r"initial\.cells\.file: .* is not the table that the sce"):
        mc.run(stale)
    (tmp_path / "mine.csv").unlink()
    with pytest.raises(SceneError, match=r"initial\.cells\.file: .* does not exist"):
        mc.run(mc.Scene.from_dict(known))


def test_changes_keep_the_table_and_another_one_replaces_it(tmp_path):
    scene = mc.load_scene(written(tmp_path, PLACES))
    other = tmp_path / "other.csv"
    other.write_text("x_um,y_um,z_um\n0,0,0\n9,0,0\n", encoding="utf-8")
    assert scene.with_changes({"seed": 3}).initial == scene.initial
    for key in ("initial.cells", "initial.cells.file"):
        assert scene.with_changes({key: str(other)}).initial.count == 2
    spaced = mc.load_scene("growth").with_changes({"initial.spacing": 1.2, "initial.count": 9})
    assert spaced.with_changes({"initial.cells": str(other)}).initial.count == 2
    without = scene.with_changes({"initial.cells": None})
    assert without.initial.cells is None
    with pytest.raises(DataError, match="but the scene has 2 dimensions"):
        scene.with_changes({"dimensions": 2})
    assert pickle.loads(pickle.dumps(scene)) == copy.deepcopy(scene) == scene
    assert not hasattr(pickle.loads(pickle.dumps(scene.initial.cells)), "_given")


def test_the_digest_is_that_of_the_content(tmp_path):
    scene = mc.load_scene(written(tmp_path, PLACES))
    (tmp_path / "there").mkdir()
    moved = mc.load_scene(written(tmp_path / "there", PLACES))
    other = mc.load_scene(written(tmp_path / "there", PLACES.replace("9", "8.5")))
    assert run_digest(moved) == run_digest(scene)
    assert run_digest(other) != run_digest(scene)


def test_cells_that_overlap_deeply_are_remarked_on(tmp_path):
    near = "x_um,y_um,z_um,radius_um\n0,0,0,4\n3.9,0,0,4\n30,0,0,4\n34.1,0,0,4\n"
    notes = explain(mc.load_scene(written(tmp_path, near)))["notes"]
    assert sum("1 pair(s) of cells in the table are nearer" in note for note in notes) == 1
    assert not any("in the table" in note for note in explain(mc.load_scene("growth"))["notes"])


def test_a_run_folder_holds_the_table_and_is_run_again_and_resumed(tmp_path):
    file = written(tmp_path, PLACES, growth={"cycle_time": "1 h"}, output={"every": "20 min"})
    shell = CliRunner()
    whole = tmp_path / "whole"
    args = ["run", str(file), "-o", str(whole), "--no-report", "--quiet", "--threads", "1"]
    assert shell.invoke(main, args).exit_code == 0
    assert (whole / "cells.csv").read_text(encoding="utf-8") == PLACES
    assert '\nfile = "cells.csv"' in (whole / "scene.toml").read_text(encoding="utf-8")
    (tmp_path / "mine.csv").unlink()
    moved = whole.rename(tmp_path / "moved")
    again = tmp_path / "again"
    args = ["run", str(moved / "scene.toml"), "-o", str(again), "--no-report", "--quiet"]
    assert shell.invoke(main, args).exit_code == 0
    assert_same_bits(again, moved)
    mc.resume(moved, 1, output=tmp_path / "resumed", report=False)
    assert_same_bits(tmp_path / "resumed", moved)
    # in its own folder too, and where the folder is written over
    mc.resume(moved, 1, report=False)
    args = ["run", str(moved / "scene.toml"), "-o", str(moved), "--overwrite", "--no-report"]
    assert shell.invoke(main, args).exit_code == 0
    assert_same_bits(again, moved)
    # what a result shows needs no table
    (moved / "cells.csv").unlink()
    assert mc.load_result(moved).scene.initial.count == 4


def test_a_folder_with_another_table_is_not_the_run(tmp_path):
    own = PLACES.replace("9", "7.25")
    file = written(tmp_path, own)
    mc.run(mc.load_scene(file), output=tmp_path / "out", report=False)
    (tmp_path / "out" / "cells.csv").write_text(own.replace("7", "8"), encoding="utf-8")
    scene = mc.load_result(tmp_path / "out").scene
    with pytest.raises(SceneError, match="is not the table that the scene was made with"):
        mc.run(scene)


def test_cells_in_memory_are_kept_in_the_folder(tmp_path):
    scene = mc.load_scene("settle").with_changes({"initial.count": 20, "duration": "10 min"})
    cells = mc.run(scene).frames[-1].cells
    held = mc.run(scene, cells=cells)
    kept = mc.run(scene, cells=cells, output=tmp_path / "out", report=False)
    again = mc.run(mc.load_scene(tmp_path / "out" / "scene.toml"))
    repeated = mc.run(held.scene)
    for result in (kept, again, repeated):
        np.testing.assert_array_equal(
            result.frames[-1].cells.position, held.frames[-1].cells.position
        )
    elsewhere = mc.Scene.from_dict(held.scene.to_dict())
    text = held.scene.to_toml()
    del held, kept, again, repeated, elsewhere, result
    (tmp_path / "lost.toml").write_text(text, encoding="utf-8")
    with pytest.raises(SceneError, match="were given in memory, to another run or process"):
        mc.run(mc.load_scene(tmp_path / "lost.toml"))


@pytest.mark.parametrize("format", ["csv", "parquet"])
def test_the_command_takes_a_table(format, tmp_path):
    mc.export(
        mc.run(mc.load_scene("settle").with_changes({"initial.count": 8, "duration": "1 min"})),
        tmp_path, format=format, tables=["cells"], frame=-1,
    )  # fmt: skip
    out = tmp_path / "out"
    args = ["run", "settle", "-o", str(out), "--cells", str(tmp_path / f"cells.{format}")]
    found = CliRunner().invoke(main, [*args, "--set", "duration=1 min", "--no-report", "--json"])
    assert found.exit_code == 0, found.output
    assert mc.load_result(out).scene.initial.count == 8
    assert (out / f"cells.{format}").is_file()
    bad = CliRunner().invoke(main, ["run", "settle", "-o", str(out), "--cells", "nowhere.csv"])
    assert bad.exit_code == 2


def test_a_study_keeps_the_table_and_varies_it(tmp_path):
    scene = mc.load_scene(written(tmp_path, PLACES))
    folder = tmp_path / "study"
    study = mc.study(scene, vary={"cells.young": ["1 kPa", "2 kPa"]}, output=folder)
    assert (folder / "cells.csv").read_text(encoding="utf-8") == PLACES
    shutil.move(tmp_path / "mine.csv", tmp_path / "gone.csv")
    study.run(cores=1)
    assert {state.state for state in mc.load_study(folder).status()} == {"done"}
    other = tmp_path / "other.csv"
    other.write_text("x_um,y_um,z_um\n0,0,0\n9,0,0\n", encoding="utf-8")
    files = [str(tmp_path / "gone.csv"), str(other)]
    varied = mc.study(
        mc.load_study(folder).plan.scene, vary={"initial.cells": files}, output=tmp_path / "varied"
    )
    assert [run.scene.initial.count for run in varied.runs] == [4, 2]


NUMBERS = {
    "text": ["10", " 1.5e1", "20"],
    "text of pandas": pd.array(["10", "15", "20"], dtype="string"),
    "categories": pd.Categorical(["10", "15", "20"]),
    "categories of numbers": pd.Categorical([10.0, 15.0, 20.0]),
    "whole, may be missing": pd.array([10, 15, 20], dtype="Int64"),
    "float, may be missing": pd.array([10, 15, 20], dtype="Float32"),
    "short": np.array([10, 15, 20], np.uint8),
    "half": np.array([10, 15, 20], np.float16),
    "decimals": [Decimal("10"), Decimal("15.0"), Decimal("2e1")],
    "objects": np.array([10, 15.0, 20], dtype=object),
}
NO_NUMBERS = {
    "text": (["10", "15", "abc"], 2, "'abc'"),
    "a comma": (["10", "1,5", "20"], 1, "'1,5'"),
    "missing text": (["10", None, "20"], 1, "is empty or NaN"),
    "missing category": (pd.Categorical(["10", None, "20"]), 1, "is empty or NaN"),
    "missing number": (pd.array([10, None, 20], dtype="Int64"), 1, "is empty or NaN"),
    "nothing": ([None, None, None], 0, "is empty or NaN"),
    "logical": ([True, False, True], 0, "'True'"),
    "logical, may be missing": (pd.array([True, None, False], dtype="boolean"), 0, "'True'"),
    "moments": (pd.to_datetime([1, 2, 3], unit="h"), 0, "'1970-01-01T01:00:00'"),
    "moments with a zone": (pd.to_datetime([1, 2, 3], unit="h", utc=True), 0, "1970-01-01"),
    "durations": (pd.to_timedelta([1, 2, 3], unit="h"), 0, "3600"),
    "lists": ([[1.0], [1.0, 2.0], [3.0]], 0, "single values|'\\[1.0\\]'"),
    "tables": ([{"a": 1}, {"a": 2}, {"a": 3}], 0, "'a': 1"),
    "bytes": ([b"1", b"2", b"3"], 0, "b'1'"),
    "decimals": ([Decimal("10"), None, Decimal("1")], 1, "is empty or NaN"),
    "complex": (np.array([1j, 2, 3]), 0, "1j"),
    "beyond whole numbers": (np.array([2**64 - 1, 1, 2], np.uint64), 0, "must be at most"),
}


def given_as(source, column):
    """Return a start with a column for x as a frame, columns, or the content of a file."""
    columns = {"position_x_um": column, "position_y_um": [0.0, 50.0, 100.0]}
    if source == "columns":
        return from_object(columns, "cells")
    frame = pd.DataFrame({title: pd.Series(list(c) if isinstance(c, list) else c)
                          for title, c in columns.items()})  # fmt: skip
    if source == "frame":
        return from_object(frame, "cells")
    if source == "csv":
        return from_bytes(frame.to_csv(index=False).encode(), "cells")
    file = io.BytesIO()
    frame.to_parquet(file)
    return from_bytes(file.getvalue(), "cells")


@pytest.mark.parametrize("source", ["frame", "columns", "parquet", "csv"])
@pytest.mark.parametrize("kind", NUMBERS)
def test_numbers_are_read_from_columns_of_any_type(kind, source):
    found = normalise(given_as(source, NUMBERS[kind]))
    assert found.columns["position_x"].dtype == np.float64
    assert found.columns["position_x"].tolist() == [10.0, 15.0, 20.0]


@pytest.mark.parametrize("source", ["frame", "columns", "parquet"])
@pytest.mark.parametrize("kind", NO_NUMBERS)
def test_what_is_no_number_is_refused_by_row_and_column(kind, source):
    column, row, said = NO_NUMBERS[kind]
    if source == "parquet" and kind == "complex":
        pytest.skip("Parquet has no complex numbers")
    with pytest.raises(DataError, match=said) as refused:
        normalise(given_as(source, column))
    if "single values" not in str(refused.value):
        assert refused.value.place == f"cells, row {row}, 'position_x_um'"
