"""Values in the folders of studies and fits that somebody has edited are refused."""

import json
import re

import numpy as np
import pytest
from studied import SHORT

import multicell as mc
from multicell.errors import OutputError
from multicell.results.documents import Lines, read_document, write_table


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    scene = mc.load_scene("growth").with_changes(SHORT)
    made = mc.study(scene, {"cells.young": "1,2 kPa"}, output=tmp_path_factory.mktemp("s") / "s")
    made.run(cores=1)
    return made


def test_a_summary_that_was_edited_is_refused(study):
    place = study.folder / "runs" / study.plan.names[0]
    path = place / "summary.json"
    text = path.read_text()
    edited = re.sub(r'"diameter": [0-9.]+', '"diameter": 171.0', text)
    assert edited != text
    path.write_text(edited)
    with pytest.raises(OutputError, match="is not what was written there"):
        mc.load_result(place)
    assert [state.state for state in study.status()] == ["failed", "done"]
    path.write_text(text)
    assert [state.state for state in study.status()] == ["done", "done"]


@pytest.mark.parametrize("way", ["left out", "repeated", "exchanged", "cut"])
def test_lines_follow_each_other(way, tmp_path):
    path = tmp_path / "lines"
    entries = [{"number": k, "value": k / 3.0} for k in range(6)]
    Lines(path).append(entries[:3])
    Lines(path).append(entries[3:])
    assert Lines(path).entries == entries
    lines = path.read_bytes().splitlines(keepends=True)
    if way == "cut":
        path.write_bytes(b"".join(lines)[:-5])
        kept = Lines(path)
        assert kept.entries == entries[:5]
        kept.append(entries[5:])
        assert path.read_bytes() == b"".join(lines)
        return
    moved = {"left out": [0, 2, 3], "repeated": [0, 1, 1, 2], "exchanged": [1, 0, 2]}[way]
    path.write_bytes(b"".join(lines[k] for k in moved))
    with pytest.raises(OutputError, match="is damaged in line"):
        Lines(path)


@pytest.mark.parametrize(
    "text", ["[" * 100_000, '{"a":' * 5000 + "1" + "}" * 5000, "[1]", "{", '{"a": 1}',
             '{"a": ' + "1" * 5000 + "}", '{"digest": 5}', "\udce4"],
)  # fmt: skip
def test_no_text_is_a_table_of_ours_by_chance(text, tmp_path):
    (tmp_path / "t.json").write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(OutputError, match=r"t\.json' is damaged"):
        read_document(tmp_path / "t.json")


def test_a_table_is_read_as_it_was_written(tmp_path):
    known = {"b": [1, 2.5, None], "a": {"x": np.float64(1 / 3), "ü": "µ"}, "nan": float("nan")}
    write_table(tmp_path / "t.json", known)
    assert read_document(tmp_path / "t.json") == {**json.loads(json.dumps(known)), "nan": None}
    assert read_document(tmp_path / "none.json") is None
