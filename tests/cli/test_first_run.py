"""Lines of a first run: its prediction, compilation, time left, and pictures."""

import os
import subprocess
import sys
import time
from importlib import import_module
from types import SimpleNamespace

import numpy as np
import pytest
from numba import njit

import multicell as mc
from multicell import __main__ as entry
from multicell.cli import progress
from multicell.cli.progress import _Clock, fitting, reporter
from multicell.compiling import COMPILATION
from multicell.compiling.listeners import PARTS, part_of
from multicell.compiling.numba_068 import is_on_disk
from multicell.host import closed
from multicell.mechanics import forces
from multicell.mechanics.neighbours import updating
from multicell.report.explain import compilation
from multicell.report.explain.cost import predict

SPHEROID = mc.load_scene("spheroid")
MISSING = {"fields": 20.0, "motion": 10.0}


@pytest.fixture(autouse=True)
def nothing_compiled(monkeypatch):
    monkeypatch.setattr(COMPILATION, "parts", {})
    monkeypatch.setattr(COMPILATION, "part", "")
    monkeypatch.setattr(COMPILATION, "begin", 0.0)


@pytest.fixture
def now(monkeypatch):
    """Return a clock that a test moves, as a list of one number."""
    moment = [1000.0]
    monkeypatch.setattr(progress.time, "perf_counter", lambda: moment[0])
    return moment


def running(time=86400.0, cells=500, finished=False):
    return SimpleNamespace(
        scene=SPHEROID, time=time, step_index=7, state=SimpleNamespace(cells=range(cells)),
        wall={"compile": 0.0},
        finished=finished,
    )  # fmt: skip


def compile_now(part, begin):
    COMPILATION.part, COMPILATION.begin = part, begin


def seconds_left(words):
    [left] = [word for word in words if word.endswith(" left")]
    numbers = left.removesuffix(" left").split()
    units = {"s": 1.0, "min": 60.0}
    return sum(float(n) * units[u] for n, u in zip(numbers[::2], numbers[1::2], strict=True))


def test_a_first_run_says_what_it_is_going_to_be(capsys, monkeypatch):
    monkeypatch.setattr(compilation, "missing_parts", lambda scene: dict(MISSING))
    with reporter(SPHEROID, page="out/live.html"):
        pass
    first, second = capsys.readouterr().err.splitlines()[:2]
    cells = predict(SPHEROID).course.cells[-1]
    assert first.startswith("About ")
    told = float(first.split()[1].replace(",", ""))
    assert told == pytest.approx(cells, rel=0.01)
    assert "some 30 s to compile, once on this machine" in first
    assert second == "The tissue so far: out/live.html"


OPENING = """
import os, sys
from multicell.cli import progress
from multicell.cli.main import main

def first():
    heavy = {"numba", "scipy.integrate._ivp", "scipy.optimize._optimize", "matplotlib", "h5py"}
    print(sorted(heavy & set(sys.modules)))
    sys.stdout.flush()
    os._exit(0)

progress.on_stderr = first
main(["run", "spheroid", "-o", "out"])
"""


def test_a_first_run_speaks_before_numba_and_solvers_are_loaded(tmp_path):
    """They take as long to load as all else before the first words."""
    done = subprocess.run(
        [sys.executable, "-c", OPENING], cwd=tmp_path, capture_output=True, text=True, check=False,
        env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "empty")},
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (0, "[]\n")


@pytest.mark.parametrize("named", [True, False])
def test_files_of_code_are_looked_for_where_numba_keeps_them(named, tmp_path, monkeypatch):
    monkeypatch.setattr(closed, "PACKAGE", str(tmp_path / "multicell"))
    monkeypatch.setattr(closed, "_of_user", lambda name: str(tmp_path / name))
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(tmp_path / "temporary"))
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    folder = tmp_path / "multicell" / "mechanics" / "__pycache__"
    if named:
        monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "code"))
        folder = tmp_path / "code" / "mechanics_0123"
    folder.mkdir(parents=True)
    (folder / "forces.other-12.py311.nbi").touch()
    assert not closed.may_be_on_disk("mechanics.forces", "forces")
    (folder / "forces.forces-12.py311.nbi").touch()
    assert closed.may_be_on_disk("mechanics.forces", "forces")


def test_a_run_with_all_code_on_disk_does_not_wait_for_a_forecast(capsys, monkeypatch):
    monkeypatch.setattr(compilation, "missing_parts", lambda scene: {})
    monkeypatch.setattr(progress.Forecast, "of", lambda scene: pytest.fail("was made"))
    with reporter(SPHEROID):
        pass
    assert capsys.readouterr().err == ""


def test_lists_of_many_cells_are_not_expected_of_few():
    missing = {"forces": 4.0, "neighbour lists": 6.0}
    few = SPHEROID.with_changes({"stop_cells": 100})
    assert "some 4 s to compile" in _Clock(few).foresee(missing)[0]
    assert "some 10 s to compile" in _Clock(SPHEROID).foresee(missing)[0]
    # the forecast states it once more: to ask for it loads numba
    assert compilation.LISTS_FROM == updating.REPAIR_FROM


@pytest.mark.parametrize(
    ("module", "part"),
    [
        ("multicell.philox", "random numbers"),
        ("multicell.nutrient.balls", "fields"),
        ("multicell.integrators.loops.adams_bashforth", "motion"),
        ("multicell.mechanics.forces", "forces"),
        ("multicell.mechanics.neighbours", "neighbour lists"),
        ("multicell.mechanics.neighbours_of_others", "forces"),
        ("mine.fields", "other functions"),
        ("multicell_more.nutrient", "other functions"),
    ],
)
def test_parts_are_named_by_their_rooms(module, part):
    assert part_of(module) == part


def test_every_part_that_is_expected_can_be_counted():
    assert set(compilation._LANDMARKS) <= set(PARTS.values())
    everything = compilation.missing_parts(SPHEROID)
    assert set(everything) <= set(compilation._LANDMARKS)
    bare = compilation.missing_parts(mc.load_scene("settle"))
    assert "fields" not in bare


@pytest.mark.parametrize("part", compilation._LANDMARKS)
def test_a_kernel_on_disk_is_found_by_the_name_of_its_file(part, tmp_path, monkeypatch):
    module, kernel, _ = compilation._LANDMARKS[part]
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    assert not closed.may_be_on_disk(module, kernel)
    dispatcher = getattr(import_module(f"multicell.{module}"), kernel)
    place = tmp_path / f"{module.split('.')[-2] if '.' in module else 'multicell'}_0"
    place.mkdir()
    (place / f"{dispatcher._cache._impl.filename_base}.py311.nbi").touch()
    assert closed.may_be_on_disk(module, kernel)


def test_a_run_of_few_cells_lacks_no_lists_and_one_of_a_single_cell_no_forces(monkeypatch):
    monkeypatch.setattr(compilation, "_is_compiled", lambda module, kernel: False)

    def lacks(**changes):
        return set(compilation.missing_parts(SPHEROID.with_changes(changes)))

    assert lacks() == set(compilation._LANDMARKS)
    assert lacks(duration="10 min") == {"random numbers", "fields"}
    few = lacks(duration="10 min", **{"initial.count": 20})
    assert few == {"random numbers", "fields", "motion", "forces"}
    clock = _Clock(SPHEROID.with_changes({"duration": "1 h"}))
    assert clock.foresee({"neighbour lists": 6.5}) == []


def test_what_is_compiled_is_counted_and_what_comes_from_disk_is_not(tmp_path, monkeypatch):
    @njit
    def twice(x):
        return 2.0 * x

    assert twice(2.0) == 4.0
    assert COMPILATION.part == ""
    assert set(COMPILATION.parts) == {"other functions"}
    took = COMPILATION.parts["other functions"]
    assert took > 0.0
    assert twice(3.0) == 6.0
    assert COMPILATION.parts == {"other functions": took}


def test_code_of_forces_on_disk_is_found():
    arguments = np.zeros(3)
    assert isinstance(arguments, np.ndarray)
    mc.run(mc.load_scene("settle").with_changes({"duration": "1 min"}), threads=1)
    assert is_on_disk(forces.forces)


def test_the_part_is_named_with_its_time_and_those_before_are_ticked(now):
    clock = _Clock(SPHEROID)
    clock.foresee(MISSING)
    assert clock.words() == ["loading"]
    COMPILATION.parts = {"random numbers": 1.0, "fields": 2.0}
    compile_now("fields", now[0])
    now[0] += 3.0
    words = clock.words()
    assert words[0] == "compiling fields, 5 s"
    assert words[2] == "✓ random numbers"


def test_between_two_functions_a_part_stays_named_with_the_last_ticks_first(now):
    clock = _Clock(SPHEROID)
    clock.foresee(MISSING)
    COMPILATION.parts = {"random numbers": 1.0, "fields": 2.0, "motion": 4.0}
    assert clock.words()[0] == "compiling motion, 4 s"  # numba does something else just now
    compile_now("motion", now[0])
    words = clock.words()
    assert words[2:] == ["✓ fields", "✓ random numbers"]
    assert fitting(words, 57).endswith("left · ✓ fields")  # beside the bar of 80 columns
    COMPILATION.part = ""
    clock.note(running())
    assert clock.words()[0] == "1.00 of 12 d"


def test_a_later_run_of_a_process_that_has_compiled_is_loading(now):
    COMPILATION.parts = {"fields": 2.0}
    clock = _Clock(SPHEROID)
    clock.foresee({})
    assert clock.words() == ["loading"]


def test_the_first_words_break_between_words(capsys, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "40")
    monkeypatch.setattr(compilation, "missing_parts", lambda scene: dict(MISSING))
    with reporter(SPHEROID):
        pass
    lines = [line.rstrip() for line in capsys.readouterr().err.splitlines()[:3]]
    assert all(len(line) <= 40 for line in lines)
    assert "once on this machine." in " ".join(lines)


def test_time_left_has_steps_compiling_and_pictures_and_falls(now):
    plain, drawing = _Clock(SPHEROID), _Clock(SPHEROID, report=True)
    for clock in (plain, drawing):
        clock.foresee(MISSING)
    run = predict(SPHEROID).seconds
    compile_now("fields", now[0])
    assert seconds_left(plain.words()) == pytest.approx(run + 30.0, rel=0.1)
    more = seconds_left(drawing.words()) - seconds_left(plain.words())
    assert more == pytest.approx(4.3, abs=1.1)
    seen = []
    for _ in range(10):
        now[0] += 1.0
        seen.append(seconds_left(plain.words()))
    assert sorted(seen, reverse=True) == seen
    assert seen[0] - seen[-1] == pytest.approx(9.0, abs=1.1)


def test_a_slower_machine_is_found_by_what_it_has_compiled(now):
    clock = _Clock(SPHEROID)
    clock.foresee({"fields": 20.0, "motion": 10.0, "forces": 10.0})
    COMPILATION.parts = {"fields": 80.0}
    compile_now("motion", now[0])
    # (80 + 5) / (20 + 5) times as long
    assert clock._compilation_left(now[0]) == pytest.approx(3.4 * 20.0)


def test_a_part_that_a_step_has_used_is_over(now):
    clock = _Clock(SPHEROID)
    clock.foresee(MISSING)
    COMPILATION.parts = {"fields": 12.0}
    before = clock._compilation_left(now[0])
    clock.note(running())
    assert clock._compilation_left(now[0]) == pytest.approx(10.0 * 17.0 / 25.0)
    assert before > clock._compilation_left(now[0])


def test_pictures_are_named_after_the_last_step(now):
    clock = _Clock(SPHEROID, report=True)
    clock.foresee(MISSING)
    clock.note(running(SPHEROID.duration, finished=True))
    words = clock.words()
    assert words[0] == "drawing pictures"
    left = seconds_left(words)
    now[0] += 2.0
    assert seconds_left(clock.words()) == pytest.approx(left - 2.0, abs=0.2)
    now[0] += 60.0
    assert clock.words()[1] == "for 1 min 2 s"
    bare = _Clock(SPHEROID)
    bare.note(running(SPHEROID.duration, finished=True))
    assert bare.words()[0] == "writing results"


@pytest.mark.parametrize(("columns", "cells", "rate"), [(120, True, True), (80, True, False)])
def test_the_rate_goes_before_the_cells(now, columns, cells, rate):
    clock = _Clock(SPHEROID)
    clock.foresee(MISSING)
    now[0] += 30.0
    clock.note(running())
    line = fitting(clock.words(), columns - 32)
    assert "left" in line
    assert ("500 cells" in line) == cells
    assert ("simulated per s" in line) == rate
    assert len(line) <= columns - 32


def test_in_a_narrow_terminal_there_is_no_bar_and_no_word_is_cut(capsys, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "40")
    monkeypatch.setattr(compilation, "missing_parts", lambda scene: dict(MISSING))
    with reporter(SPHEROID) as note:
        note(running())
        time.sleep(0.3)
    shown = capsys.readouterr().err
    assert "━" not in shown
    assert "…" not in shown
    assert "1.00 of 12 d" in shown
    assert "left" in shown
    assert "500 cells" not in shown


def test_at_least_one_part_is_shown_whatever_the_width():
    assert fitting(["first", "second"], 3) == "first"
    assert fitting(["first", "second"], 14) == "first · second"
    assert fitting(["first", "second", "x"], 14) == "first · second"


def test_a_command_leaves_its_end_to_who_watches_it(tmp_path, monkeypatch):
    arguments = ["-m", "cProfile", "-o", "profile", "-m", "multicell", "scenes"]
    subprocess.run([sys.executable, *arguments], cwd=tmp_path, check=True, capture_output=True)
    assert (tmp_path / "profile").stat().st_size > 10_000
    assert not entry._is_watched()
    # of Python 3.12 and later, where profilers are not what sys.getprofile() returns
    tools = SimpleNamespace(get_tool=lambda number: "cProfile" if number == 2 else None)
    monkeypatch.setattr(sys, "monitoring", tools, raising=False)
    assert entry._is_watched()
