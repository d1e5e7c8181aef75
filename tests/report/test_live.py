"""The page that shows the tissue while a run goes on, and what it costs."""

import io
import re
import time
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image

import multicell as mc
from multicell.biology.initial import initial_cells
from multicell.cells import State
from multicell.cli.main import main
from multicell.errors import OutputError
from multicell.report import live
from multicell.report.colours import STATE_COLOURS, TYPE_COLOURS
from multicell.report.plots import style
from multicell.results.folder import LIVE, PASSING, RUN_FILES, is_begun, lock_folder
from multicell.results.writer import Store
from multicell.runner import RunOptions, record_run

SMALL = mc.load_scene("growth").with_changes({"initial.count": 20, "duration": "1 h"})


@pytest.fixture(autouse=True)
def no_pictures(monkeypatch):
    """Let reports have no pictures: most of their time goes into them."""
    monkeypatch.setattr("multicell.report.page.PICTURES", {})


def rgb(colour):
    return tuple(int(colour[k : k + 2], 16) for k in (1, 3, 5))


def pixels(data):
    picture = Image.open(io.BytesIO(data)).convert("RGB")
    assert picture.size == (live.WIDE, live.HIGH)
    return np.asarray(picture)


def part(data, colour):
    """Return which part of a picture, below its words, has a colour."""
    shown = pixels(data)[:, 250:750]
    return (np.abs(shown.astype(int) - rgb(colour)).max(axis=2) < 12).mean()


def one_cell(state=State.PROLIFERATING, scene=SMALL):
    cells = initial_cells(scene).take(np.zeros(1, dtype=np.int64))
    cells.state[:] = state
    return cells


@pytest.mark.parametrize("state", list(State))
def test_a_cell_is_a_disc_of_the_colour_of_its_state(state):
    data = live.drawn(one_cell(state), SMALL, 0.0)
    disc = np.pi * (0.42 * live.HIGH) ** 2 / (live.HIGH * 500)
    assert part(data, STATE_COLOURS[state.name.lower()]) == pytest.approx(disc, rel=0.03)


def test_only_cells_that_the_plane_cuts_are_drawn_and_each_with_its_cut():
    cells = initial_cells(SMALL).take(np.array([0, 0, 0]))
    cells.radius[:] = 5.0
    cells.position[:] = [[0.0, 0.0, 4.0], [0.0, 0.0, -4.0], [0.0, 0.0, 0.0]]
    cells.state[:] = [State.NECROTIC, State.NECROTIC, State.QUIESCENT]
    data = live.drawn(cells, SMALL, 0.0)
    # that of the middle, drawn last, has the radius 5 µm and covers those of 3 µm
    assert part(data, STATE_COLOURS["quiescent"]) > 0.5
    assert part(data, STATE_COLOURS["necrotic"]) == 0.0
    cells.position[2, 0] = 60.0
    apart = live.drawn(cells, SMALL, 0.0)
    assert 0.0 < part(apart, STATE_COLOURS["necrotic"]) < 0.05
    cells.position[:2, 2] = [9.0, -9.0]
    assert part(live.drawn(cells, SMALL, 0.0), STATE_COLOURS["necrotic"]) == 0.0


def test_types_have_the_colours_of_sections():
    scene = mc.load_scene("sorting-cams").with_changes({"initial.count": 40})
    cells = initial_cells(scene)
    cells.position[:, 2] = 0.0
    data = live.drawn(cells, scene, 0.0)
    assert all(part(data, TYPE_COLOURS[kind]) > 0.01 for kind in np.unique(cells.kind))
    assert STATE_COLOURS is style.STATE_COLOURS


def test_no_cell_at_all_and_a_crowd_can_be_drawn():
    none = initial_cells(SMALL).take(np.zeros(0, dtype=np.int64))
    assert part(live.drawn(none, SMALL, 0.0), STATE_COLOURS["proliferating"]) == 0.0
    many = initial_cells(SMALL.with_changes({"initial.count": 20000}))
    assert part(live.drawn(many, SMALL, 0.0), STATE_COLOURS["proliferating"]) > 0.2


def seen_while(folder, **options):
    """Run a scene; return what its folder had at the first step, and the result."""
    seen = []

    def look(simulation):
        if not seen:
            seen.append({path.name for path in folder.iterdir()})

    result = mc.run(SMALL, output=folder, progress=look, threads=1, **options)
    return seen[0], result


def test_page_and_picture_are_there_before_the_first_step_and_gone_with_the_report(tmp_path):
    seen, _ = seen_while(tmp_path / "out")
    assert set(LIVE) <= seen
    left = {path.name for path in (tmp_path / "out").iterdir()}
    assert not left & {*LIVE, *PASSING}
    assert "report.html" in left


def test_without_a_report_there_is_no_picture(tmp_path):
    seen, _ = seen_while(tmp_path / "out", report=False)
    assert not seen & set(LIVE)
    record_run(SMALL, RunOptions(output=tmp_path / "two", threads=1))
    assert not {path.name for path in (tmp_path / "two").iterdir()} & set(LIVE)


def test_pictures_change_no_bit_of_the_run(tmp_path, monkeypatch):
    monkeypatch.setattr(live, "_LEAST", 0.0)
    monkeypatch.setattr(live, "_SHARE", 1e9)
    drawn = []
    plain = live.drawn
    monkeypatch.setattr(live, "drawn", lambda *given: drawn.append(given[2]) or plain(*given))
    _, shown = seen_while(tmp_path / "shown")
    _, bare = seen_while(tmp_path / "bare", report=False)
    assert len(drawn) == 1 + len(shown.history["time"])  # the first cells, and every row
    for one, other in zip(shown.frames, bare.frames, strict=True):
        assert one.cells.position.tobytes() == other.cells.position.tobytes()
        assert one.cells.pressure.tobytes() == other.cells.pressure.tobytes()


def test_pictures_take_a_hundredth_of_the_time(tmp_path, monkeypatch):
    now = [0.0]
    monkeypatch.setattr(live.clock, "perf_counter", lambda: now[0])

    def slow(*_):
        now[0] += 0.5
        return b""

    monkeypatch.setattr(live, "drawn", slow)
    page = live.LivePage(tmp_path, SMALL)
    moment = SimpleNamespace(state=SimpleNamespace(cells=[1]), time=0.0)
    spent = 0.0
    for _ in range(10_000):
        now[0] += 0.1
        begin = now[0]
        page.note(moment)
        spent += now[0] - begin
    assert 0.005 < spent / now[0] < 0.0105


def test_a_full_disk_ends_the_pictures_and_not_the_run(tmp_path, monkeypatch):
    def full(path, *_):
        raise OutputError(f"cannot write '{path}': No space left on device")

    monkeypatch.setattr(live, "write_bytes", full)
    monkeypatch.setattr(live, "write_text", full)
    _, result = seen_while(tmp_path / "out")
    assert result.frames[-1].time == SMALL.duration


@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError])
def test_a_run_that_ends_early_leaves_no_picture(tmp_path, error):
    def stop(simulation):
        raise error

    with pytest.raises(error):
        mc.run(SMALL, output=tmp_path / "out", progress=stop, threads=1)
    assert not {path.name for path in (tmp_path / "out").iterdir()} & set(LIVE)


def test_what_a_killed_run_has_left_of_it_is_in_nobodys_way(tmp_path):
    """Before its first frame the folder is begun anew; afterwards the run is resumed."""
    folder = tmp_path / "out"
    Store.create(folder, SMALL).close()
    for name in (*LIVE, f"{LIVE[0]}.part"):
        (folder / name).write_bytes(b"of a killed run")
    assert not is_begun(folder, {})
    result = mc.run(SMALL, output=folder, threads=1)
    assert not {path.name for path in folder.iterdir()} & {*LIVE, f"{LIVE[0]}.part"}
    (folder / LIVE[0]).write_bytes(b"of a killed run")
    again = mc.resume(folder, changes={"duration": "70 min"}, threads=1)
    assert again.frames[-1].time > result.frames[-1].time
    assert not (folder / LIVE[0]).exists()


def test_a_resumed_run_shows_the_cells_of_its_frame(tmp_path, monkeypatch):
    folder = tmp_path / "out"
    mc.run(SMALL, output=folder, threads=1)
    drawn = []
    monkeypatch.setattr(live, "drawn", lambda cells, scene, time: drawn.append(time) or b"")
    mc.resume(folder, changes={"duration": "70 min"}, threads=1)
    assert drawn[0] == SMALL.duration


def test_view_shows_the_picture_of_a_run_that_has_no_frame_yet(tmp_path):
    folder = tmp_path / "out"
    store = Store.create(folder, SMALL)
    (folder / LIVE[1]).write_text("page", "utf-8")
    shown = CliRunner().invoke(main, ["view", str(folder), "--no-browser"])
    assert (shown.exit_code, shown.output.strip()) == (0, str(folder / LIVE[1]))
    store.close()  # a run that was killed: its picture is old
    again = CliRunner().invoke(main, ["view", str(folder), "--no-browser"])
    assert LIVE[1] not in again.output


def test_files_of_the_picture_are_no_results(tmp_path):
    assert not set(LIVE) & {*RUN_FILES, *PASSING}
    with lock_folder(tmp_path):
        live.LivePage(tmp_path, SMALL).open()
        assert {path.name for path in tmp_path.iterdir()} >= set(LIVE)
    page = (tmp_path / LIVE[1]).read_text("utf-8")
    assert re.search(r"script-src 'sha256-[\w+/=]+'", page)
    assert "http" not in page.partition("</style>")[2]
    begin = time.perf_counter()
    live.drawn(initial_cells(SMALL), SMALL, 0.0)
    assert time.perf_counter() - begin < 2.0


def test_a_report_takes_the_place_of_the_picture_of_a_killed_run(tmp_path):
    folder = tmp_path / "out"
    result = mc.run(SMALL, output=folder, threads=1)
    for name in LIVE:
        (folder / name).write_bytes(b"of a killed run")
    with lock_folder(folder):  # of a run that goes on
        result.report()
        assert (folder / LIVE[0]).exists()
    result.report()
    assert not {path.name for path in folder.iterdir()} & set(LIVE)
