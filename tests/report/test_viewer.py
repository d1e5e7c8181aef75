"""Cells in space and time: what is packed against the store, and the page in a browser."""

import base64
import gzip
import hashlib
import html
import io
import json
import re
import shutil

import numpy as np
import pytest
from click.testing import CliRunner

import multicell as mc
from multicell.cells import Cells, State
from multicell.cli.main import main
from multicell.population import extents
from multicell.report.result import Result
from multicell.report.viewer import pack
from multicell.results.frame import Frame


def spread(count, time=0.0, seed=1):
    rng = np.random.default_rng(seed)
    ids = np.sort(rng.choice(10 * count, count, replace=False))
    cells = Cells(
        id=ids, parent=np.full(count, -1), position=rng.uniform(-200.0, 300.0, (count, 3)),
        radius=rng.uniform(3.0, 6.0, count), young=np.ones(count), poisson=np.full(count, 0.5),
        state=rng.integers(0, len(State), count), age=np.zeros(count),
        cycle_time=np.ones(count), pressure=rng.normal(size=count),
    )  # fmt: skip
    return Frame(time, 0, cells)


def result_of(*frames):
    return Result(None, frames, {}, {}, mc.load_scene("settle"))


def unpacked(view):
    """Return the columns of each frame, as the page's script reads them."""
    body = np.frombuffer(gzip.decompress(base64.b64decode(view.data)), "u1")
    at, found, levels = 0, [], []
    for frame in view.about["frames"]:
        count, columns, raw = frame["shown"], {}, {}
        for column in view.about["columns"]:
            name, size = column["name"], np.dtype(column["kind"]).itemsize
            planes = body[at : at + size * count].reshape(size, count).astype(np.int64)
            at += size * count
            folded = sum(plane << (8 * k) for k, plane in enumerate(planes))
            change = (folded >> 1) ^ -(folded & 1)
            if name == "id":
                values = np.cumsum(change)
            else:
                before = dict(zip(levels[-1]["id"], levels[-1][name], strict=True)) if found else {}
                values = change + np.array([before.get(i, 0) for i in raw["id"]], dtype=np.int64)
                values %= 2 ** (8 * size)
            raw[name] = values
            if name != "id" and "words" not in column:
                values = column["low"] + (column["high"] - column["low"]) * values / column["top"]
            columns[name] = values
        levels.append(raw)
        found.append(columns)
    assert at == len(body)
    return found


def test_what_is_packed_is_the_run_within_its_rounding():
    frames = spread(40), spread(101, 3600.0, seed=2)
    view = pack.pack_frames(result_of(*frames))
    for frame, columns in zip(frames, unpacked(view), strict=True):
        cells = frame.cells
        np.testing.assert_array_equal(columns["id"], cells.id)
        np.testing.assert_array_equal(columns["state"], cells.state)
        for k, axis in enumerate("xyz"):
            np.testing.assert_allclose(columns[axis], cells.position[:, k], atol=0.6 * 500 / 16383)
        np.testing.assert_allclose(columns["radius"], cells.radius, atol=0.6 * 3 / 255)
        spread_ = np.ptp(np.concatenate([f.cells.pressure for f in frames]))
        np.testing.assert_allclose(columns["pressure"], cells.pressure, atol=0.6 * spread_ / 255)
    assert view.note == ""
    assert [entry["cells"] for entry in view.about["frames"]] == [40, 101]


def test_many_cells_are_thinned_the_same_way_in_all_frames_and_it_is_said():
    first = spread(1000)
    second = Frame(3600.0, 1, first.cells.take(np.arange(800)))
    view = pack.pack_frames(result_of(first, second), max_cells=300)
    shown = [set(columns["id"].tolist()) for columns in unpacked(view)]
    assert [len(ids) for ids in shown] == [300, 300]
    # who is there in both and shown in the fuller one is shown in the other
    assert shown[0] & set(second.cells.id.tolist()) <= shown[1]
    assert "Of more than 300 cells in a frame so many are drawn" in view.note


def test_what_is_too_large_is_thinned_until_it_fits():
    view = pack.pack_frames(result_of(spread(4000)), max_bytes=20_000)
    assert len(base64.b64decode(view.data)) <= 20_000
    assert 500 < view.about["frames"][0]["shown"] < 4000


def test_of_many_frames_first_and_last_and_some_between_are_shown():
    frames = [spread(5, float(k)) for k in range(173)]
    view = pack.pack_frames(result_of(*frames))
    times = [entry["time"] for entry in view.about["frames"]]
    assert len(times) == pack.MAX_FRAMES
    assert (times[0], times[-1]) == (0.0, 172.0)
    assert np.ptp(np.diff(times)) <= 1.0
    assert view.note == "50 of 173 frames are shown."


def test_curves_have_at_every_frame_the_numbers_of_that_frame():
    """The history has more rows than the curves have points, and frames between them."""
    changes = {"duration": "80 h", "coupling_step": "10 min", "output.every": "1.5 h"}
    long_run = mc.run(mc.load_scene("growth").with_changes(changes))
    view = pack.pack_frames(long_run, max_cells=12)
    assert len(long_run.history["time"]) > pack.POINTS
    frames = [frame for frame in long_run.frames if len(frame.cells)]
    chosen = {frame.time: frame for frame in frames}
    curves = {curve["name"]: curve["values"] for curve in view.about["curves"]}
    assert len(view.about["frames"]) == pack.MAX_FRAMES
    for entry in view.about["frames"]:
        frame, point = chosen[entry["time"]], entry["point"]
        assert view.about["times"][point] == frame.time
        assert curves["cells"][point] == entry["cells"] == len(frame.cells)
        across = extents.Extent(frame.cells, 3).diameter()
        assert curves["diameter"][point] == pytest.approx(across, rel=1e-5)
        at = long_run.history["time"] == frame.time
        counts = [int(long_run.history[state.name.lower()][at][0]) for state in State]
        groups = entry["groups"]["state"]
        assert groups == counts[: len(groups)]
        assert sum(groups) == len(frame.cells)
    assert view.about["frames"][-1]["shown"] < view.about["frames"][-1]["cells"]


def test_a_frame_that_the_history_lacks_has_no_point_on_the_curves():
    history = {"time": np.arange(3.0), "step": np.arange(3.0), "cells": np.full(3, 5.0)}
    frames = spread(5), Frame(7.0, 7, spread(5).cells)
    view = pack.pack_frames(Result(None, frames, history, {}, mc.load_scene("settle")))
    assert [entry["point"] for entry in view.about["frames"]] == [0, None]


def test_a_run_without_cells_has_nothing_to_see():
    assert pack.pack_frames(result_of(Frame(0.0, 0, Cells.empty()))) is None


def test_cells_that_move_little_are_packed_in_few_bytes_and_unpacked_as_they_were():
    """Some die and some are born between frames, so that rows change."""
    rng, first = np.random.default_rng(3), spread(5000)
    moved = first.cells.take(np.sort(rng.choice(5000, 4900, replace=False)))
    moved.position += rng.normal(0.0, 0.5, moved.position.shape)
    born = spread(100, seed=9).cells
    born.id += 100_000
    rows = {name: np.concatenate([old, getattr(born, name)]) for name, old in moved.columns()}
    second = Frame(3600.0, 1, Cells(**rows))
    alone = len(base64.b64decode(pack.pack_frames(result_of(first)).data))
    view = pack.pack_frames(result_of(first, second))
    assert len(base64.b64decode(view.data)) < 1.6 * alone
    _, columns = unpacked(view)
    np.testing.assert_array_equal(columns["id"], second.cells.id)
    np.testing.assert_array_equal(columns["state"], second.cells.state)
    wide = np.ptp(second.cells.position) + 10.0
    np.testing.assert_allclose(columns["x"], second.cells.position[:, 0], atol=0.6 * wide / 16383)


@pytest.mark.slow
def test_a_view_is_exported_as_a_page_of_its_own(run, tmp_path):
    (path,) = mc.export(run, tmp_path, format="page")
    page = path.read_text("utf-8")
    assert path.name == "view.html"
    assert "default-src 'none'" in page
    assert 'id="viewer-data"' in page
    with pytest.raises(mc.OutputError, match="nothing to show"):
        mc.export(result_of(Frame(0.0, 0, Cells.empty())), tmp_path / "none", format="page")


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    scene = mc.load_scene("spheroid").with_changes(
        {
            "duration": "30 h",
            "initial.count": 60,
            "output.every": "10 h",
            "title": "A </script> & b",
        }
    )
    return mc.run(scene, output=tmp_path_factory.mktemp("viewer") / "run")


def test_the_page_allows_its_own_scripts_and_nothing_else(run):
    page = (run.folder / "report.html").read_text("utf-8")
    policy = html.unescape(re.search(r'Content-Security-Policy" content="([^"]+)"', page)[1])
    assert policy.startswith(
        "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src "
    )
    scripts = re.findall(r"<script>(.*?)</script>", page, re.DOTALL)
    hashes = {base64.b64encode(hashlib.sha256(s.encode()).digest()).decode() for s in scripts}
    assert set(re.findall(r"'sha256-([^']+)'", policy)) == hashes
    assert len(hashes) == 2
    assert "http://" not in re.sub(r"http://www\.w3\.org/\S+", "", scripts[1])


@pytest.fixture
def opened(browser, run, request):
    wide, scheme = request.param
    context = browser.new_context(  # coarse pixels in a large window: software draws them
        viewport={"width": wide, "height": 900}, color_scheme=scheme,
        device_scale_factor=390.0 / wide,
    )  # fmt: skip
    page, said = context.new_page(), []
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on(
        "request", lambda asked: said.append(asked.url) if "report.html" not in asked.url else None
    )
    page.goto((run.folder / "report.html").as_uri())
    page.wait_for_selector("#viewer.ready", timeout=60_000)
    page.wait_for_function("window.multicellViewer.draws() > 0", timeout=60_000)
    yield page
    assert said == []  # no error, no warning, nothing loaded
    context.close()


def colours(page):
    """Return the pixels of the cells' part of the page, (h, w, 3)."""
    from PIL import Image

    # what moved is drawn sharply a moment later, and then takes its time to the screen
    before, picture, tries = b"", b"none", 0
    while picture != before:
        tries += 1
        assert tries < 30, "the picture does not come to rest"
        page.wait_for_timeout(500)
        page.evaluate("new Promise(r => requestAnimationFrame(() => requestAnimationFrame(r)))")
        before, picture = picture, page.locator('[data-part="canvas"]').screenshot()
    return np.asarray(Image.open(io.BytesIO(picture)).convert("RGB")).astype(int)


def check_counts(page):
    """Status, curve and legend say one number of cells at every frame."""
    shown = page.evaluate(
        """multicellViewer.frames.map((frame, k) => {
          multicellViewer.show(k);
          const part = (name) => document.querySelector(`[data-part="${name}"]`).textContent;
          const charts = [...document.querySelectorAll(".curves svg")];
          const chart = charts.find((svg) => svg.querySelector("text").textContent === "Cells");
          return [`${frame.cells}`, part("status").match(/: (\\S+) cell/)[1],
                  chart.querySelector(".value").textContent.trim(), part("legend")];
        })"""
    )
    for count, *said, legend in shown:
        groups = re.findall(r"\(([\d,]+)\)", legend)
        assert {*said, str(sum(map(int, groups)))} == {count}


def check_layout(page):
    """Curves can be read, the slider is at the cells, nothing is wider than the window."""
    assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
    heights = page.evaluate(
        """[...document.querySelectorAll(".curves text:not(.small)")]
        .filter((text) => text.textContent).map((text) => text.getBoundingClientRect().height)"""
    )
    assert len(heights) > 2
    assert min(heights) > 11.0  # letters of 10 px and more
    cells = page.locator('[data-part="canvas"]').bounding_box()
    slider = page.locator('[data-part="time"]').bounding_box()
    assert 0.0 < slider["y"] - (cells["y"] + cells["height"]) < 80.0


def check_pointer(page, cells):
    """The numbers told are those of the cell under the pointer."""
    box = page.locator('[data-part="canvas"]').bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    told = dict(
        line.split(": ") for line in page.locator('[data-part="tip"]').inner_text().splitlines()
    )
    row = int(cells.rows_of(np.array([int(told["cell"])]))[0])
    assert float(told["radius"].split()[0]) == pytest.approx(cells.radius[row], abs=0.02)
    assert told["state"] == State(int(cells.state[row])).name.lower()
    # on the line of sight through the middle, and nearer to the eye than all others there
    middle = np.average(cells.position, axis=0, weights=cells.radius**3)
    sight = np.array([0.45, -0.8, 0.4]) / np.linalg.norm([0.45, -0.8, 0.4])
    along = (cells.position - middle) @ sight
    aside = np.linalg.norm(cells.position - middle - along[:, None] * sight, axis=1)
    on = aside < cells.radius + 0.3
    assert on[row]
    depth = along + np.sqrt(np.maximum(cells.radius**2 - aside**2, 0.0))
    assert depth[row] >= depth[on].max() - 0.5
    page.mouse.move(0, 0)


def check_play(page, count):
    """Space plays to the last frame, a click into a curve goes to its time, the bar is true."""
    from playwright.sync_api import expect

    page.locator('[data-part="time"]').focus()
    page.keyboard.press("Home")
    page.select_option('[data-part="speed"]', "30")
    page.locator('[data-part="canvas"]').focus()
    page.keyboard.press(" ")
    expect(page.locator('[data-part="time"]')).to_have_value(str(count - 1), timeout=60_000)
    expect(page.locator('[data-part="play"]')).to_have_text("Play", timeout=60_000)
    chart = page.locator(".curves svg").first
    box = chart.bounding_box()
    chart.click(position={"x": 0.03 * box["width"], "y": 0.5 * box["height"]})
    assert page.locator('[data-part="time"]').input_value() == "0"
    page.click('[data-part="home"]')
    colours(page)
    bar = page.locator('[data-part="bar"]').bounding_box()["width"]
    wide = page.locator('[data-part="canvas"]').bounding_box()["width"]
    length = float(page.locator('[data-part="bar"]').inner_text().split()[0])
    across = page.evaluate("multicellViewer.across()")
    assert bar / wide == pytest.approx(length / across, rel=0.02)


def check_still(page):
    """The picture has cells, is saved under the time, and is what the page prints."""
    with page.expect_download() as saved:
        page.click('[data-part="picture"]')
    assert saved.value.suggested_filename == "cells 0 h.png"
    from PIL import Image

    picture = np.asarray(Image.open(saved.value.path()).convert("RGB")).astype(int)
    assert (picture[:5, :5] == 255).all()
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 100
    page.emulate_media(media="print")
    page.wait_for_timeout(300)
    still = page.locator('[data-part="still"]')
    assert still.bounding_box()["height"] > 100
    assert still.evaluate("sheet => sheet.width") == picture.shape[1]
    assert page.locator('[data-part="canvas"]').bounding_box() is None
    page.emulate_media(media="screen")


@pytest.mark.slow
@pytest.mark.parametrize("opened", [(390, "dark"), (1280, "light")], indirect=True)
def test_the_page_shows_cells_and_its_controls_work(opened, run):
    """One page opened for all, as drawing in software takes most of the time."""
    assert opened.locator('[data-part="axis"]').input_value() == "y"  # cut open
    opened.select_option('[data-part="axis"]', "none")
    last = colours(opened)
    assert len(np.unique(last.reshape(-1, 3), axis=0)) > 100
    count = len(run.frames[-1].cells)
    status = opened.locator('[data-part="status"]')
    assert f"{count} cells" in status.inner_text()
    check_counts(opened)
    check_layout(opened)
    check_pointer(opened, run.frames[-1].cells)
    # with every cell drawn the picture is the same: only what nobody sees is left out
    drawn = opened.evaluate("window.multicellViewer.visible()")
    opened.evaluate("window.multicellViewer.all(true)")
    np.testing.assert_array_equal(colours(opened), last)
    assert opened.evaluate("window.multicellViewer.visible()") > drawn
    opened.evaluate("window.multicellViewer.all(false)")
    opened.locator('[data-part="time"]').focus()
    opened.keyboard.press("Home")
    assert f"{len(run.frames[0].cells)} cells" in status.inner_text()
    first = colours(opened)
    assert np.abs(first - last).max() > 50
    opened.locator('[data-part="canvas"]').focus()
    opened.keyboard.press("ArrowLeft")
    turned = colours(opened)
    assert np.abs(turned - first).max() > 50
    opened.select_option('[data-part="colour"]', "oxygen")
    assert "mM" in opened.locator('[data-part="legend"]').inner_text()
    assert np.abs(colours(opened) - turned).max() > 50
    opened.click('[data-part="home"]')
    before = opened.evaluate("window.multicellViewer.visible()")
    opened.select_option('[data-part="axis"]', "x")
    colours(opened)
    assert 0 < opened.evaluate("window.multicellViewer.visible()") < before
    check_play(opened, len(run.frames))
    check_still(opened)
    opened.set_viewport_size({"width": 800, "height": 900})
    check_layout(opened)


def test_view_writes_the_page_where_it_is_older_than_the_run(run, tmp_path, monkeypatch):
    opened = []
    monkeypatch.setattr("multicell.report.page.PICTURES", {})
    monkeypatch.setattr("webbrowser.open", lambda address: opened.append(address) or True)
    folder = tmp_path / "run"
    shutil.copytree(run.folder, folder)
    (folder / "report.html").unlink()
    for _ in range(2):
        done = CliRunner().invoke(main, ["view", str(folder)])
        assert done.exit_code == 0, done.output
    assert opened == 2 * [(folder / "report.html").resolve().as_uri()]
    written = (folder / "report.html").stat().st_mtime_ns
    done = CliRunner().invoke(main, ["view", str(folder), "--no-browser", "--json"])
    assert json.loads(done.output) == {"file": str(folder / "report.html")}
    assert (folder / "report.html").stat().st_mtime_ns == written
    assert len(opened) == 2
    assert CliRunner().invoke(main, ["view", str(tmp_path / "nowhere")]).exit_code == 2
