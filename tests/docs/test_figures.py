"""Figures of pages are those of the tables, and pictures show methods that there are."""

from __future__ import annotations

import importlib
import re
import stat
import xml.etree.ElementTree as ET
from types import ModuleType

import pandas as pd
import pytest
from page_commands import ROOT, pages

from multicell.comparison.null_methods import NULL_METHODS
from multicell.integrators.registry import METHODS
from multicell.studies.runs import MODEL_VERSION

DOCS = ROOT / "docs"
COMPARISONS = {
    "brownian.png", "compare-stiff-inclusions.png", "mathias2022.png", "osborne2024.png",
    "tiles-fine.png", "tiles.png",
}  # fmt: skip
PUBLISHED = {"theirs", "backward", "FE", "MP", "BE", "RK4", "shifted", "threshold Euler",
             "threshold RK4"}  # fmt: skip
"""Methods of two papers, in the tables of their comparisons."""
MARK = "<!-- figure: "


@pytest.fixture(scope="module")
def programs() -> dict[str, ModuleType]:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(DOCS / "programs"))
        names = ("marked", "performance", "physicell_speed", "picture_origins", "speed_tables")
        return {name: importlib.import_module(name) for name in names}


# figures


def test_every_marked_figure_is_that_of_the_tables(programs):
    known, marks = programs["speed_tables"].figures(), {}
    for page in pages():
        text = page.read_text("utf-8")
        assert programs["speed_tables"].requote(text, known) == text, page.name
        marks[page.name] = text.count(MARK)
    assert min(marks[name] for name in ("README.md", "index.md", "peers.md", "faq.md")) >= 1


def test_the_tables_of_the_page_are_made_from_the_measurements(programs):
    measured, text = programs["speed_tables"], (DOCS / "performance.md").read_text("utf-8")
    for name, block in measured.BLOCKS.items():
        same = programs["marked"].replaced(text, name, block(measured.read()))
        assert same == text, name


def sentences(text: str) -> list[str]:
    """Return the sentences of a page without code, tables and what scripts have made."""
    text = re.sub(r"<!-- ([^>]+): made by \S+.*?-->.*?<!-- end of \1 -->", "", text, flags=re.S)
    text = re.sub(r"^```.*?^```", "", text, flags=re.S | re.M)
    prose = "\n".join(row for row in text.splitlines() if not row.lstrip().startswith("|"))
    return re.split(r"(?<=[.;])\s|\n\s*\n", prose)


def unmarked(text: str) -> list[str]:
    """Return sentences with a speed of large tissues, or beside PhysiCell, without a mark."""
    return [
        said
        for said in sentences(text)
        if MARK not in said
        and (
            (re.search(r"\bmillion\b|\bhour of\b", said) and re.search(r"\d (s|GB)\b", said))
            or ("PhysiCell" in said and re.search(r"\d (times|×)", said))
        )
    ]


def test_no_page_states_a_speed_of_its_own():
    assert [
        (page.name, said) for page in pages() for said in unmarked(page.read_text("utf-8"))
    ] == []
    # sentences that three pages had, with three figures for one thing
    assert unmarked("A simulated hour of a million cells takes 36 s\non one thread; more is rare.")
    assert unmarked("It takes 1.1 GB for a million cells.")
    assert unmarked("That is 1,168 times the speed of PhysiCell.")


@pytest.mark.parametrize(
    ("value", "like", "expected"),
    [
        (14.38, "20", "10"), (14.38, "36", "14"), (14.38, "14.4", "14.4"), (9.96, "14.4", "9.96"),
        (7963.0, "8,000", "8,000"), (7963.0, "7,980", "7,960"), (0.127, "0.2", "0.1"),
        (0.127, "0.13", "0.13"), (1168.2, "1,168", "1,168"), (382.0, "1,168", "382.0"),
        (0.99, "1", "1"),
    ],
)  # fmt: skip
def test_a_figure_is_printed_with_the_digits_that_stand_there(programs, value, like, expected):
    assert programs["speed_tables"].round_like(value, like) == expected


def test_a_wrong_figure_or_mark_is_noticed(programs):
    requote, known = programs["speed_tables"].requote, {"a": 14.4}
    assert requote("takes 36 s<!-- figure: a -->", known) == "takes 14 s<!-- figure: a -->"
    with pytest.raises(KeyError):
        requote("takes 36 s<!-- figure: b -->", known)
    with pytest.raises(ValueError, match="no number before it"):
        requote("takes long<!-- figure: a -->", known)


# measurements


def test_rounds_go_through_everything_in_turns(programs, monkeypatch):
    performance = programs["performance"]
    monkeypatch.setattr(performance, "load_of_others", lambda: 0.25)
    clock = iter(range(1, 7))
    jobs = [
        ({"what": "beside", "program": program, "cells": 1000, "threads": 2},
         lambda: {"seconds": float(next(clock))})
        for program in ("PhysiCell 1", "multicell")
    ]  # fmt: skip
    rows = performance.take_turns(
        jobs, 3, {"machine": "m", "date": "d", "note": ""}, lambda row: None
    )
    assert list(rows["program"].str[0]) == ["P", "m", "m", "P", "P", "m"]
    assert list(rows["round"]) == [1, 1, 2, 2, 3, 3]
    rows = rows.reindex(columns=programs["speed_tables"].read().columns)
    # 1/2, 4/3 and 5/6 of the rounds, not the ratio of the medians
    ratio = programs["speed_tables"].ratios(rows)["ratio"]
    assert sorted(ratio) == pytest.approx([1 / 2, 5 / 6, 4 / 3])
    middle = programs["speed_tables"].medians(rows).set_index("program").loc["PhysiCell 1"]
    assert (middle["least"], middle["seconds"], middle["most"]) == (1.0, 4.0, 5.0)
    assert "Medians of 3 rounds in turns" in programs["speed_tables"].origin(rows)
    assert "other programs used up to 25 % of it" in programs["speed_tables"].origin(rows)


def test_what_is_measured_again_replaces_its_rows(programs, tmp_path, monkeypatch):
    measured = programs["speed_tables"]
    whole = measured.read()
    path = tmp_path / "speed.csv"
    path.write_bytes(measured.TABLE.read_bytes())
    monkeypatch.setattr(measured, "TABLE", path)
    rounds = whole[(whole["what"] == "hour") & (whole["cells"] == 1_000_000)]
    part = rounds.drop_duplicates("threads")
    new = pd.concat([part.assign(round=k, seconds=part["seconds"] + k) for k in (1, 2, 3)])
    measured.write(new)
    again = measured.read()
    same = again["what"].ne("hour") | again["cells"].ne(1_000_000)
    assert len(again) == len(whole) - len(rounds) + 3 * len(part)
    rest = whole.drop(rounds.index).reset_index(drop=True)
    assert again[same].reset_index(drop=True).equals(rest)
    known = measured.figures()["hour, 1000000 cells, 1 thread"]
    assert known == part.loc[part["threads"] == 1, "seconds"].item() + 2.0


FAKE = """#!/bin/sh
echo "total agents: 8"
for s in 3 63.5 100.25; do echo "total wall time: 0 days, 0 hours, 0 minutes, and $s seconds "; done
"""


def template() -> str:
    """Return settings with no more than what a measurement changes."""
    top = ET.Element("PhysiCell_settings")
    ends = [f"domain/{axis}_{end}" for axis in "xyz" for end in ("min", "max")]
    others = [
        "domain/use_2D",
        "overall/max_time",
        "parallel/omp_num_threads",
        "save/full_data/interval",
        "save/full_data/enable",
        "save/SVG/enable",
        "user_parameters/number_of_cells",
        "microenvironment_setup/variable/physical_parameter_set/decay_rate",
        "microenvironment_setup/variable/initial_condition",
        "microenvironment_setup/variable/Dirichlet_boundary_condition",
        "cell_definitions/cell_definition/phenotype/secretion/substrate/uptake_rate",
        "initial_conditions/cell_positions",
    ]
    for path in [*ends, *others]:
        place = top
        for name in path.split("/"):
            found = place.find(name)
            place = ET.SubElement(place, name) if found is None else found
    return ET.tostring(top, encoding="unicode")


def test_the_hour_of_physicell_is_that_of_the_window_after_its_warm_up(programs, tmp_path):
    speed = programs["physicell_speed"]
    source = tmp_path / "source"
    (source / speed.TEMPLATE).parent.mkdir(parents=True)
    (source / speed.TEMPLATE).write_text(template())
    (source / "VERSION.txt").write_text("1.2.3\n")
    (source / "project").write_text(FAKE)
    (source / "project").chmod((source / "project").stat().st_mode | stat.S_IXUSR)
    place = speed.build(source, tmp_path)
    assert speed.version(place) == "PhysiCell 1.2.3"
    assert speed.hour(place, 8, (6.0, 6.0), 2) == pytest.approx(36.75 * 10.0)
    assert speed.hour(place, 8, (0.0, 12.0), 2) == pytest.approx(97.25 * 5.0)
    said = (place / "config" / "PhysiCell_settings.xml").read_text()
    assert "<max_time>12</max_time>" in said
    with pytest.raises(ValueError, match="multiples of 6 min"):
        speed.hour(place, 8, (2.0, 3.0), 2)
    with pytest.raises(ValueError, match="did not begin with 9 cells"):
        speed.hour(place, 9, (6.0, 6.0), 2)
    with pytest.raises(ValueError, match="3 times, not 4"):
        speed.hour(place, 8, (6.0, 12.0), 2)


# pictures


def test_every_picture_has_its_origin_and_is_what_was_made(programs):
    made, digest = programs["picture_origins"].read(), programs["picture_origins"].digest
    files = {path.name for path in (DOCS / "figures").iterdir()} - {"origins.json"}
    assert set(made) == files
    for name, entry in made.items():
        program = re.fullmatch(r"python (\S+\.py)(?: .*)?", entry["command"])
        if program is not None:
            assert (ROOT / program[1]).exists(), name
        if "digest" in entry:
            assert entry["digest"] == digest(DOCS / "figures" / name), name
    assert {name for name, entry in made.items() if "methods" in entry} == COMPARISONS


def test_the_page_of_programs_lists_every_program_with_a_cost():
    text = (DOCS / "programs.md").read_text("utf-8")
    rows = dict(re.findall(r"^\| `python docs/(\S+)\.py[^`]*` \|.+\| (.+) \|$", text, re.M))
    files = {path.stem: path.read_text("utf-8") for path in (DOCS / "programs").glob("*.py")}
    programs = {f"programs/{name}" for name, code in files.items() if "__main__" in code}
    assert set(rows) == programs | {"wm983b"}
    assert all(re.search(r"second|minute|hour|printed", cost) for cost in rows.values())
    modules = set(re.findall(r"`(\w+)`", text.rpartition("The other files")[2]))
    assert modules == set(files) - {name.removeprefix("programs/") for name in programs}


def test_pictures_of_comparisons_show_methods_of_the_registry(programs):
    made = programs["picture_origins"].read()
    for name in COMPARISONS:
        assert set(made[name]["methods"]) <= set(METHODS), name
        assert "digest" in made[name]
    # this one is said to show them all
    assert set(made["compare-stiff-inclusions.png"]["methods"]) == set(METHODS)


def test_tables_and_pages_name_methods_of_the_registry():
    for path in sorted((DOCS / "chart-data").glob("*.csv")):
        table = pd.read_csv(path)
        if "method" in table:
            gone = set(table["method"]) - set(METHODS) - set(NULL_METHODS) - PUBLISHED
            assert gone == set(), path.name
    first = {name.partition("-")[0] for name in METHODS} | {"sundials"}
    for page in pages():
        named = set(re.findall(r"`([a-z]+\d*(?:-[a-z0-9]+)*)`", page.read_text("utf-8")))
        like = {name for name in named if name.partition("-")[0] in first} - {"scipy"}
        assert like <= set(METHODS), page.name


def test_pictures_of_the_built_in_spheroid_are_of_the_present_model(programs):
    """If this fails, the model has changed: run ``python docs/programs/moving_pictures.py``."""
    made = programs["picture_origins"].read()
    for name in ("spheroid.webp", "section.png"):
        assert made[name]["model"] == MODEL_VERSION
    assert made["spheroid.webp"]["facts"] == made["section.png"]["facts"]


def test_digests_and_methods_are_noted_beside_a_picture(programs, tmp_path):
    made, picture = programs["picture_origins"], tmp_path / "a.png"
    picture.write_bytes(b"one")
    made.record(picture, "python a.py", ["rkc2", "auto", "rkc2"], facts={"cells": 3})
    entry = made.read(tmp_path)["a.png"]
    assert entry["methods"] == ["auto", "rkc2"]
    assert entry["facts"] == {"cells": 3}
    picture.write_bytes(b"two")
    assert made.digest(picture) != entry["digest"]
