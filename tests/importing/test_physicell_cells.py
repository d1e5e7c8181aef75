"""Tables of cells, files that are written, and what is refused."""

import json
import os
import re
import shutil
import time

import numpy as np
import pytest
from click.testing import CliRunner
from physicell_project import writer

import multicell as mc
from multicell.cli.main import main
from multicell.importing.files import read_xml
from multicell.importing.imported import Fate

TITLED = """x,y,z,type,volume,cycle entry,custom:GFP
0,0,0,tumour cell,3000,skip,
15,0,0,tumour cell,,,
15,0,0,tumour cell
-40,10,0,hunter,500,0.1
500,0,0,hunter
0,40,0,nobody
"""


def call(*arguments):
    return CliRunner().invoke(main, [str(a) for a in arguments])


def test_cells_without_titles_are_named_by_their_number(project):
    made = mc.import_physicell(project())
    assert made.cells["kind"].tolist() == ["tumour_cell"] * 3 + ["hunter"]
    np.testing.assert_array_equal(made.cells["position_z_um"], [0, 0, 4, 0])
    volume = 4.0 / 3.0 * np.pi * made.cells["radius_um"] ** 3
    np.testing.assert_allclose(volume, [2494, 2494, 2494, 1200])
    assert set(made.cells["phase"]) == {"G1"}


def test_cells_with_titles(project):
    made = mc.import_physicell(project(cells=TITLED))
    volume = 4.0 / 3.0 * np.pi * made.cells["radius_um"] ** 3
    np.testing.assert_allclose(volume, [3000, 2494, 2494, 500])
    known = {entry.path: entry for entry in made.entries}
    assert known["cells.csv, volume"].fate is Fate.MAPPED
    assert known["cells.csv, cycle entry"].fate is Fate.LEFT_OUT
    assert known["cells.csv, custom:gfp"].fate is Fate.OFF
    notes = [entry.note for entry in made.entries if entry.path == "cells.csv"]
    assert sum("outside the box" in note for note in notes) == 1
    assert sum("types that there are not" in note for note in notes) == 1
    assert sum("are moved by" in note for note in notes) == 1
    place = np.stack([made.cells[f"position_{axis}_um"] for axis in "xyz"], axis=1)
    assert 0.5 < np.linalg.norm(place[2] - place[1]) < 1.5


def test_a_plane_has_no_height(project):
    flat = ("<use_2D>false</use_2D>", "<use_2D>true</use_2D>")
    made = mc.import_physicell(project(flat))
    assert made.scene.dimensions == 2
    assert made.scene.nutrients["oxygen"].height == 20.0
    assert "z+" not in made.scene.nutrients["oxygen"].sides
    assert not made.cells["position_z_um"].any()


def test_what_is_written_is_read_back(project, tmp_path):
    made = mc.import_physicell(project())
    made.write(tmp_path / "out")
    scene = mc.load_scene(tmp_path / "out" / "scene.toml")
    ours, theirs = scene.to_dict(), made.scene.to_dict()
    assert ours["initial"]["cells"].pop("file").endswith("cells.csv")
    theirs["initial"]["cells"].pop("file")
    assert ours == theirs
    page = (tmp_path / "out" / "account.md").read_text(encoding="utf-8")
    assert page.count("\n| ") - 4 == len(made.entries)
    assert "duration = 3600.0  # s" in (tmp_path / "out" / "scene.toml").read_text()


def test_an_imported_model_runs(project):
    changes = [("<dx>20</dx><dy>20</dy><dz>20</dz>", "<dx>40</dx><dy>40</dy><dz>40</dz>")]
    scene = mc.import_physicell(project(*changes)).scene
    result = mc.run(scene.with_changes({"duration": "10 min", "integrator": "euler"}))
    first, last = (
        frame.cells.position[np.argsort(frame.cells.id)]
        for frame in (result.frames[0], result.frames[-1])
    )
    # the hunter moves at 0.5 to 1 of its speed of 2 um/min, the others hardly
    way = np.linalg.norm(last - first, axis=1)
    assert 4.0 < way[3] < 22.0
    assert way[:3].max() < 3.0
    assert 0.0 < result.frames[-1].concentrations["oxygen"].min() < 38.0 * 1.41e-3


def test_the_command_tells_what_it_did(project, tmp_path):
    path = project()
    done = call("import", "physicell", path, "-o", tmp_path / "out")
    assert done.exit_code == 0, done.output
    assert "off: see" in done.output
    assert "elastic walls" in (tmp_path / "out" / "account.md").read_text("utf-8")
    assert "multicell run" in done.output
    again = call("import", "physicell", path, "-o", tmp_path / "out")
    assert again.exit_code == 2
    assert "exists already" in again.output
    whole = (tmp_path / "out" / "cells.csv").read_bytes()
    (tmp_path / "out" / "cells.csv").unlink()  # as a full disk leaves it
    assert call("import", "physicell", path, "-o", tmp_path / "out").exit_code == 0
    assert (tmp_path / "out" / "cells.csv").read_bytes() == whole
    (tmp_path / "out" / "cells.csv").unlink()
    (tmp_path / "out" / "account.md").write_text("mine")
    assert call("import", "physicell", path, "-o", tmp_path / "out").exit_code == 2
    told = call("import", "physicell", path, "-o", tmp_path / "out", "--overwrite", "--json")
    document = json.loads(told.output)
    assert document["counts"]["mapped"] > 40
    assert {entry["fate"] for entry in document["entries"]} == {str(fate.value) for fate in Fate}
    assert call("import", "morpheus", path, "-o", tmp_path / "other").exit_code == 2


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("<x_min>-100</x_min>", "<x_min>left</x_min>", r"line 4, domain/x_min: is 'left', must be"),
        ("<x_min>-100</x_min>", "<x_min>200</x_min>", "must be below x_max"),
        ("<x_min>-100</x_min>", "", "has no x_min"),
        (">60</max_time>", ">-1</max_time>", r"overall/max_time: is -1, must be at least 0"),
        (">7</random_seed>", ">dice</random_seed>", "no random seed"),
        ('code="6"', 'code="66"', "has the code '66', must be one of 0 Ki67"),
        ('index="3" fixed', 'index="4" fixed', "is of phase 4, but"),
        ('name="hunter" ID="3"', 'name="hunter" ID="0"', "has the name or ID of 'tumour cell'"),
        ('name="hunter" ID="3"', 'name="hunter" ID="3" parent_type="x"', "is no type above it"),
        ("<filename>cells.csv<", "<filename>cell.csv<", "but there is no such file. Looked for in"),
        ("<domain>", "<!-- <domain>", "is not well-formed XML"),
        ("PhysiCell_settings", "MorpheusModel", "is of 'MorpheusModel', must be settings"),
    ],
)
def test_what_is_refused_with_its_place(project, old, new, said):
    with pytest.raises(mc.SceneError, match=said):
        mc.import_physicell(project((old, new)))


@pytest.mark.parametrize(
    ("cells", "said"),
    [
        ("1,2,3\n", "line 1: has 3 columns"),
        ("1,2,nan,0\n", "line 1: has a coordinate"),
        ("x,y,type\n1,2,0\n", "begins with 'x,y,type'"),
        ("x,y,z,type,volume\n1,2,3,hunter,-5\n", "volume of -5, must be above 0"),
        ("", "has no cells"),
    ],
)
def test_tables_of_cells_that_are_refused(project, cells, said):
    with pytest.raises(mc.SceneError, match=said):
        mc.import_physicell(project(cells=cells))


def test_nothing_is_expanded_or_fetched(project, tmp_path):
    path = project()
    laughs = '<!DOCTYPE a [<!ENTITY b "x"><!ENTITY c "&b;&b;">]>'
    for head in (laughs, '<!DOCTYPE a SYSTEM "file:///etc/passwd">'):
        text = path.read_text(encoding="utf-8").replace("?>\n", f"?>\n{head}\n", 1)
        bad = tmp_path / "bad.xml"
        bad.write_text(text, encoding="utf-8")
        with pytest.raises(mc.SceneError, match="line 2: has a document type"):
            mc.import_physicell(bad)
    (tmp_path / "deep.xml").write_text("<a>" * 100 + "</a>" * 100)
    with pytest.raises(mc.SceneError, match="nested too deeply"):
        mc.import_physicell(tmp_path / "deep.xml")
    with pytest.raises(mc.SceneError, match="cannot be read: Is a directory"):
        mc.import_physicell(tmp_path)
    with pytest.raises(mc.SceneError, match="there is no file"):
        mc.import_physicell(tmp_path / "none.xml")
    (tmp_path / "latin.xml").write_bytes(b"<a>\xff</a>")
    with pytest.raises(mc.SceneError, match="is not UTF-8"):
        mc.import_physicell(tmp_path / "latin.xml")


SECRET = "root:x:0:0:a line that no message may quote\n"


def named(project, cells, *, folder="./config"):
    """Return settings that name a file of cells."""
    path = project()
    text = path.read_text(encoding="utf-8")
    old = re.search(r"<folder>[^<]*</folder>\s*<filename>cells.csv</filename>", text)[0]
    new = f"<folder>{folder}</folder><filename>{cells}</filename>"
    path.write_text(text.replace(old, new), encoding="utf-8")
    return path


@pytest.mark.parametrize("way", ["absolute", "absolute folder", "dots", "folder of dots",
                                 "link", "linked folder", "circle"])  # fmt: skip
def test_no_file_outside_the_model_is_opened_or_quoted(tmp_path, way):
    model = tmp_path / "model"
    model.mkdir()
    secret = tmp_path / "secret" / "cells.txt"
    secret.parent.mkdir()
    secret.write_text(SECRET)
    project = writer(model)
    project()
    (model / "config" / "linked").symlink_to(secret)
    (model / "config" / "outside").symlink_to(secret.parent)
    (model / "config" / "circle").symlink_to(model / "config" / "circle")
    given = {
        "absolute": {"cells": str(secret)},
        "absolute folder": {"cells": secret.name, "folder": str(secret.parent)},
        "dots": {"cells": "../../secret/cells.txt"},
        "folder of dots": {"cells": secret.name, "folder": "../secret"},
        "link": {"cells": "linked"},
        "linked folder": {"cells": secret.name, "folder": "./config/outside"},
        "circle": {"cells": "circle"},
    }
    with pytest.raises(mc.SceneError) as refused:
        mc.import_physicell(named(project, **given[way]))
    assert "a line that no message" not in str(refused.value)
    assert re.search("is not below the folder|is not opened", str(refused.value))


def test_settings_in_no_config_folder_read_their_own_folder_only(tmp_path):
    inner = tmp_path / "inner"
    inner.mkdir()
    path = writer(inner)()
    alone = inner / "mine"
    shutil.copytree(inner / "config", alone)
    assert len(mc.import_physicell(alone / path.name).cells["radius_um"]) == 4
    (alone / "cells.csv").rename(inner / "cells.csv")
    text = (alone / path.name).read_text().replace("<folder>./config</folder>", "")
    (alone / path.name).write_text(text)
    with pytest.raises(mc.SceneError, match="no such file"):
        mc.import_physicell(alone / path.name)


@pytest.mark.parametrize("name", ["pipe", "x" * 5000, "config", "rows", "zero"])
def test_what_is_no_table_of_cells_is_refused_at_once(project, name):
    config = project().parent
    os.mkfifo(config / "pipe")
    (config / "rows").write_text("x,y,z,type\n" + "9" * 200_000 + ",1,1,hunter\n")
    with (config / "zero").open("wb") as file:
        file.truncate(100_000_001)
    begin = time.perf_counter()
    with pytest.raises(mc.SceneError, match=r"no such file|is no row of CSV|larger than 100 MB"):
        mc.import_physicell(named(project, name))
    assert time.perf_counter() - begin < 5.0


def refusal(path):
    """Return why settings are refused, or nothing."""
    try:
        mc.import_physicell(path)
    except mc.SceneError as error:
        return str(error)
    return ""


@pytest.mark.slow
@pytest.mark.parametrize("word", ["", "wrong", "-1", "0", "1e300"])
def test_any_wrong_number_is_imported_or_refused_in_words(project, word):
    path = project()
    lines = path.read_text(encoding="utf-8").split("\n")
    refused = 0
    for leaf in list(read_xml(path).leaves()):
        text = leaf.text
        if not text.strip():
            continue
        changed = list(lines)
        line = changed[leaf.line - 1]
        changed[leaf.line - 1] = line.replace(f">{text}</{leaf.tag}>", f">{word}</{leaf.tag}>", 1)
        path.write_text("\n".join(changed), encoding="utf-8")
        said = refusal(path)
        refused += bool(said)
        if said:
            assert any(name in said for name in (".xml", "cells.csv")), leaf.path
    assert refused > 5
