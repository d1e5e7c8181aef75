"""The page of a study: complete, self-contained, and true to the runs."""

import re
from dataclasses import replace
from html import unescape

import numpy as np
import pytest
from study_tables import grid, sampled, with_states
from synthetic import SCENE

import multicell as mc
from multicell.results.observables import centre
from multicell.studies import spheroids
from multicell.studies.page import key_observables, write_study_report
from multicell.studies.runs import StudyRun
from multicell.studies.status import RunStatus

OXYGEN, LAW = "oxygen.boundary", "law"
BAD = "step failed <script>alert(1)</script> & so on"


def runs_of(table, names):
    """Return a run for each point and seed of a grid, and its state; one has failed."""
    shape = [table.sizes[name] for name in names]
    runs, states = [], []
    for place in np.ndindex(*shape, table.sizes["seed"]):
        values = {n: table[n].values[k].item() for n, k in zip(names, place, strict=False)}
        seed = int(table["seed"].values[place[-1]])
        name = f"run{'-'.join(map(str, place))}"
        scene = replace(SCENE, seed=seed)
        runs.append(StudyRun(name, scene, {**values, "seed": seed}, 1.0))
        failed = not any(place)
        states.append(
            RunStatus(name, "failed", BAD) if failed else RunStatus(name, "done", wall=60.0)
        )
    return runs, states


@pytest.fixture(scope="module")
def table():
    return with_states(grid(OXYGEN, LAW, seeds=2), failed=[(0, 0, 0)])


def words(markup):
    """Return the texts between tags."""
    return [unescape(text.strip()) for text in re.split("<[^>]+>", markup) if text.strip()]


def rows_of(html):
    """Return the texts of each row of the table of runs."""
    body = html.partition('<section class="runs">')[2].partition("<tbody>")[2]
    return [words(row) for row in re.findall(r"<tr.*?</tr>", body, re.DOTALL)]


def written(folder, table, names):
    runs, states = runs_of(table, names)
    path = write_study_report(folder, SCENE, table, runs, states, shown=["diameter"])
    return path.read_text("utf-8")


@pytest.fixture(scope="module")
def folder(table, tmp_path_factory):
    """Write one page, which most tests look at."""
    place = tmp_path_factory.mktemp("study")
    written(place, table, (OXYGEN, LAW))
    return place


@pytest.fixture(scope="module")
def html(folder):
    return (folder / "report.html").read_text("utf-8")


def test_the_page_stands_alone_and_escapes_all(html):
    bare = re.sub(r"base64,[\w+/=]+", "", html)
    assert not re.search(r"https?:|//[a-z]|@import|url\(|<script", bare)
    assert "default-src 'none'" in html
    assert "alert(1)&lt;/script&gt; &amp; so on" in html


def test_every_run_is_a_row_with_its_state_and_reason(table, html):
    rows = rows_of(html)
    assert len(rows) == 18
    (failed,) = [row for row in rows if "failed" in row]
    assert BAD in failed
    diameter = f"{table['diameter'].values[2, 1, 1, -1]:.4g}"
    (row,) = [row for row in rows if row[-1] == "run2-1-1"]
    assert {diameter, "hertz"} <= set(row)


def test_the_head_tells_what_is_not_done_and_how_long_all_took(html):
    text = words(html)
    assert "Of 18 runs 1 failed" in text
    assert "law (3)" in " ".join(text)
    assert text[text.index("wall time of all runs") - 1] == "17 min 0 s"


def test_a_study_of_which_nothing_has_run_has_a_page(tmp_path):
    table = grid(OXYGEN, seeds=2)
    runs, _ = runs_of(table, (OXYGEN,))
    states = [RunStatus(run.name, "waiting") for run in runs]
    bare = table.drop_vars(list(table.data_vars))
    bare["state"] = ((OXYGEN, "seed"), np.full((3, 2), "waiting", dtype=object))
    text = write_study_report(tmp_path, SCENE, bare, runs, states).read_text("utf-8")
    assert "Of 6 runs 6 not finished" in text
    assert "not run" in rows_of(text)[0]
    assert not list(tmp_path.glob("*.png"))  # not a picture of empty tiles


@pytest.mark.slow
def test_a_sample_has_a_page_with_points_over_each_axis(tmp_path):
    table = sampled(OXYGEN, LAW, count=6, seeds=2)
    runs, states = [], []
    for point in range(6):
        for seed in (0, 1):
            own = {OXYGEN: float(table[OXYGEN][point]), LAW: str(table[LAW].values[point])}
            name = f"run{point}-{seed}"
            runs.append(StudyRun(name, SCENE, {**own, "seed": seed}, 1.0))
            states.append(RunStatus(name, "done", wall=1.0))
    text = write_study_report(tmp_path, SCENE, table, runs, states, shown=["diameter"]).read_text(
        "utf-8"
    )
    assert len(rows_of(text)) == 12
    assert (tmp_path / "response-diameter.png").exists()
    assert not list(tmp_path.glob("map-*.png"))


def test_observables_that_stay_the_same_are_left_out():
    table = grid(OXYGEN)
    table["pull"] = table["cells"] * 0.0 + 0.7
    table["largest_pressure"] = table["cells"] * np.nan
    assert key_observables(table) == ["cells", "diameter", "viable_rim", "necrotic_radius"]


def test_of_very_many_runs_those_that_failed_are_listed_first(table, tmp_path, monkeypatch):
    monkeypatch.setattr("multicell.studies.page.MAX_ROWS", 5)
    runs, states = runs_of(table, (OXYGEN, LAW))
    states[-1] = RunStatus(states[-1].name, "failed", "late")
    page = write_study_report(tmp_path, SCENE, table, runs, states, shown=[])
    text = page.read_text("utf-8")
    rows = rows_of(text)
    assert len(rows) == 5
    assert sum("failed" in row for row in rows) == 2
    assert "13 runs are left out here" in text


# the picture of all tissues


def tissues_of(folder, points, dimensions=3):
    """Return runs at some points with two seeds each, of which some ended; their states."""
    runs, states = [], []
    for number, (oxygen, ended) in enumerate(points):
        for seed in (1, 2):
            changes = {"seed": seed, "initial.count": 5 + number, "dimensions": dimensions}
            scene = mc.load_scene("growth").with_changes({**changes, "duration": "20 min"})
            name = f"run-{number}-{seed}"
            if ended:
                mc.run(scene, output=folder / "runs" / name, report=False)
            runs.append(StudyRun(name, scene, {OXYGEN: oxygen, "seed": seed}, 1.0))
            states.append(RunStatus(name, "done" if ended else "waiting"))
    return runs, states


@pytest.mark.parametrize("dimensions", [2, 3])
def test_picture_has_a_tissue_of_each_point_that_is_done(tmp_path, dimensions):
    points = [(0.02, True), (0.03, False), (0.05, True)]
    runs, states = tissues_of(tmp_path, points, dimensions)
    found = spheroids.last_tissues(tmp_path, runs, states)
    assert [(run.name, len(frame.cells)) for run, frame in found] == [
        ("run-0-1", 5), ("run-2-1", 7)
    ]  # fmt: skip
    figure = spheroids.spheroids(grid(OXYGEN, seeds=2), "A study", found, 3)
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert [title.splitlines()[1] for title in titles] == ["5 cells", "7 cells"]
    assert ["0.02" in titles[0], "0.05" in titles[1]] == [True, True]
    assert "2 of 3 points" in "".join(text.get_text() for text in figure.texts)
    assert len({axes.get_xlim() for axes in figure.axes}) == 1
    drawn = [len(axes.collections[0].get_offsets()) for axes in figure.axes]
    cut = [
        len(f.cells) if dimensions == 2 else (abs(z_of(f)) < f.cells.radius).sum()
        for _, f in found
    ]  # fmt: skip
    assert drawn == cut


def z_of(frame):
    return (frame.cells.position - centre(frame.cells, 3))[:, 2]


def test_damaged_frames_leave_their_tissue_out(tmp_path):
    runs, states = tissues_of(tmp_path, [(0.02, True), (0.05, True)])
    (tmp_path / "runs" / "run-0-1" / "frames.h5").write_bytes(b"no frames")
    found = spheroids.last_tissues(tmp_path, runs, states)
    assert [run.name for run, _ in found] == ["run-1-1"]


def test_page_without_results_has_no_tissues(table, folder):
    assert not (folder / "tissues.png").exists()


def test_each_picture_has_a_caption_of_its_own(table, tmp_path):
    html = written(tmp_path, table, [OXYGEN, LAW])
    captions = re.findall(r"<figcaption>(.*?)</figcaption>", html)
    assert len(captions) == len(set(captions)) > 1
    assert all(text.startswith("Diameter ") for text in captions)
