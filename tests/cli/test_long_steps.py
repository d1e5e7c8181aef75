"""A step that works for long says so, with a terminal and without one."""

import time
from types import SimpleNamespace

import multicell as mc
from multicell.cli import progress
from multicell.cli.progress import _Clock, display


def test_a_line_says_so_where_there_is_no_terminal(capsys, monkeypatch):
    monkeypatch.setattr(progress, "_LONG", 0.1)
    with display(lambda: ["step 7", "the next for 3 min"], lambda share: share, lines=10) as note:
        note(0.1)
        time.sleep(0.55)
        quiet = capsys.readouterr().err
    assert "10 %  step 7" in quiet
    lines = quiet.splitlines()
    assert 1 < len(lines) < 7
    assert {line.strip() for line in lines[1:]} == {"step 7 · the next for 3 min"}
    time.sleep(0.25)
    assert capsys.readouterr().err == ""


def test_steps_with_news_print_no_more_lines(capsys, monkeypatch):
    monkeypatch.setattr(progress, "_LONG", 0.2)
    with display(lambda: ["words"], lambda share: share, lines=10) as note:
        for _ in range(10):
            note(0.1)
            time.sleep(0.05)
    assert capsys.readouterr().err.splitlines() == [" 10 %  words"]


def test_the_words_have_the_time_of_the_step(monkeypatch):
    clock = _Clock(mc.load_scene("growth"))
    running = SimpleNamespace(
        scene=mc.load_scene("growth"), time=600.0, step_index=1,
        state=SimpleNamespace(cells=[1]), wall={"compile": 0.0},
        finished=False,
    )  # fmt: skip
    clock.note(running)
    assert not any("the next" in word for word in clock.words())
    now = time.perf_counter()
    monkeypatch.setattr(progress.time, "perf_counter", lambda: now + 200.0)
    assert clock.words()[-1] == "the next for 3.3 min"
