"""The page with sliders: the real server on loopback, its runs, and who it answers."""

import contextlib
import json
import math
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request
from pathlib import Path
from types import SimpleNamespace
from urllib.parse import urlsplit

import numpy as np
import pytest
from click.testing import CliRunner
from signals import listening

import multicell as mc
from multicell.cli.main import main
from multicell.cli.playground import Playground, _Handler, verdict
from multicell.cli.slider_keys import asked_units, default_ranges
from multicell.studies.axes import check_ranges, parse_ranges

KEY = "nutrients.oxygen.boundary"
SMALL = [
    *("--set", "initial.count=16", "--set", "duration=2 h", "--set", "output.every=20 min"),
    *("--key", f"{KEY}=1:21 %", "--no-browser"),
]


def asked(address, path="/", method="GET", body=None, **headers):
    """Return status and text of an answer; the address has the secret."""
    parts = urlsplit(address)
    url = f"http://{parts.netloc}{path}?{parts.query}"
    data = None if body is None else json.dumps(body).encode()
    request = urllib.request.Request(url, data, headers, method=method)
    try:
        with urllib.request.urlopen(request, timeout=60) as answer:
            return answer.status, answer.read()
    except urllib.error.HTTPError as error:
        return error.code, error.read()


@contextlib.contextmanager
def served(place, options=SMALL):
    """Return the process of the command and its address; temporary files are in ``place``."""
    process = subprocess.Popen(
        [sys.executable, "-m", "multicell", "play", "treatment", *options, "--no-browser"],
        env={**os.environ, "TMPDIR": str(place)}, preexec_fn=listening,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        address = process.stdout.readline().strip()
        assert address.startswith("http://127.0.0.1:"), process.stderr.read()
        yield process, address
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    """Return the address of a server."""
    with served(tmp_path_factory.mktemp("play")) as (_, found):
        yield found


def wait_for(address, condition, seconds=240.0):
    """Return the status of the newest run once a condition holds for it."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        status = json.loads(asked(address, "/run")[1])
        if condition(status):
            return status
        time.sleep(0.3)
    raise AssertionError(status)


def test_only_those_who_know_the_secret_are_answered(address):
    assert asked(address)[0] == 200
    bare = address.partition("?")[0]
    for path in ("/", "/run", "/view", "/curves"):
        assert asked(f"{bare}?token=guessed", path)[0] == 403
    assert asked(f"{bare}?", "/run", "POST", {"places": [0]})[0] == 403
    assert asked(address, Host="evil.example")[0] == 403  # a name that leads to this machine


def test_another_origin_is_not_answered(address):
    own = f"http://{urlsplit(address).netloc}"
    assert asked(address, Origin=own)[0] == 200
    for origin in ("http://evil.example", "null", "https" + own[4:], own + "0", ""):
        assert asked(address, Origin=origin)[0] == 403
        assert asked(address, "/run", "POST", {"places": [0]}, Origin=origin)[0] == 403


WRONG_BODIES = {
    "deep": b"[" * 9000, "deep table": b'{"a":' * 1800, "bytes": bytes(range(256)), "nothing": b"",
    "digits": b'{"places": [%s]}' % (b"9" * 5000), "large": b'{"places": [%s]}' % (b"9" * 400),
}  # fmt: skip


@pytest.mark.slow
def test_no_body_makes_the_server_tell_its_secret(tmp_path):
    with served(tmp_path) as (process, address):
        for body in WRONG_BODIES.values():
            request = urllib.request.Request(address.replace("/?", "/run?"), body, method="POST")
            with pytest.raises(urllib.error.HTTPError) as caught:
                urllib.request.urlopen(request, timeout=60)
            assert caught.value.code in (400, 422)
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0
        assert process.stderr.read() == ""


def test_the_secret_is_handed_over_by_a_file_of_its_own(monkeypatch):
    """Arguments of processes can be read by all users of a machine."""
    secret, opened = "http://127.0.0.1:5/?token=abc", []

    def called(address):
        file = Path(urllib.request.url2pathname(urlsplit(address).path))
        opened.append((address, file.stat().st_mode & 0o777, file.parent.stat().st_mode & 0o777))
        assert f'content="0; url={secret}"' in file.read_text("utf-8")
        return True

    monkeypatch.setattr("webbrowser.open", called)
    monkeypatch.setattr("multicell.cli.playground.serve", lambda ground, port, ready: ready(secret))
    answer = CliRunner().invoke(main, ["play", "treatment", *SMALL[:-1]])
    assert answer.exit_code == 0, answer.output
    [(address, mode, folder)] = opened
    assert (mode, folder) == (0o600, 0o700)
    assert "abc" not in address
    assert address.startswith("file://")


def test_an_unforeseen_error_is_logged_without_the_secret(caplog):
    handler = object.__new__(_Handler)
    handler.request = SimpleNamespace(method="GET", path="/run", uri="/run?token=abc")
    handler.log_exception(ValueError, ValueError("why"), None)
    assert "GET /run" in caplog.text
    assert "why" in caplog.text
    assert "abc" not in caplog.text


@pytest.mark.slow
def test_a_slider_begins_a_run_that_can_be_seen(address):
    page = asked(address)[1].decode()
    slider = json.loads(re.search(r'id="about">(.*?)</script>', page, re.S)[1])[0]
    assert slider["key"] == KEY
    assert (slider["low"], slider["unit"]) == (1.0, "%")  # as it was asked for
    assert asked(address, "/run", "POST", {"places": [0]})[0] == 200
    status = wait_for(address, lambda s: not s["going"])
    assert (status["part"], status["frames"]) == (1.0, 7)
    assert "done" in status["text"]
    code, view = asked(address, "/view")
    assert code == 200
    assert b'id="viewer-data"' in view
    assert asked(address, "/curves")[1][:4] == b"\x89PNG"


@pytest.mark.parametrize(
    "body", [{"places": []}, {"places": [-1]}, {"places": ["x"]}, {"places": None}, {}, [], "x"]
)
def test_what_is_no_place_of_a_slider_is_refused(address, body):
    assert asked(address, "/run", "POST", body)[0] in (400, 422)


@pytest.mark.slow
def test_an_interrupt_ends_the_server_with_its_run(tmp_path):
    with served(tmp_path) as (process, address):
        number = json.loads(asked(address, "/run", "POST", {"places": [500]})[1])["number"]
        status = json.loads(asked(address, "/run")[1])
        assert (status["number"], status["going"]) == (number, True)
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0
        assert process.stderr.read() == ""
        assert list(tmp_path.glob("multicell-play-*")) == []
    if Path("/proc").is_dir():
        running = [p.read_bytes() for p in Path("/proc").glob("[0-9]*/cmdline") if _there(p)]
        assert not [line for line in running if str(tmp_path).encode() in line]


def _there(file):
    try:
        return bool(file.read_bytes())
    except OSError:
        return False


def test_older_runs_go_and_another_run_ends_the_one_before(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    scene = mc.load_scene("treatment")
    with Playground(scene, parse_ranges({KEY: "1:21 %"}, scene), 1.0, "") as ground:
        ground.start([0])
        first = ground._worker
        ground.start([1000])
        assert first.returncode == -signal.SIGTERM
        assert ground.status()["going"] is True
        ground.stop()
        assert ground.status()["going"] is False
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("pages", [1, 2])
def test_a_disk_without_room_for_a_run_is_said_in_words(pages, small_disk, monkeypatch):
    mount, _ = small_disk
    disk = mount(4 * pages)
    monkeypatch.setattr(tempfile, "tempdir", str(disk))
    scene = mc.load_scene("treatment")
    with Playground(scene, parse_ranges({KEY: "1:21 %"}, scene), 1.0, "") as ground:
        (disk / "others").write_bytes(bytes(4096))
        with pytest.raises(mc.OutputError, match="No space left on device"):
            ground.begin()
        assert (ground.number, ground.status()["going"]) == (0, False)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["spheroid", "--key", "drag.viscosty=1:2"], "Did you mean 'drag.viscosity'"),
        (["spheroid", "--key", "drag.viscosity"], "write the value without a space"),
        (["spheroid", "--key", "drag.viscosity=2:1"], "must have the lower end first"),
    ],
)
def test_what_cannot_be_played_is_refused(arguments, words):
    answer = CliRunner().invoke(main, ["play", *arguments, "--no-browser"])
    assert answer.exit_code == 2
    assert words in " ".join(answer.output.split())


@pytest.mark.parametrize("name", mc.scene_names())
def test_every_built_in_scene_has_sliders_about_its_own_values(name):
    scene = mc.load_scene(name)
    texts = default_ranges(scene)
    assert 0 < len(texts) <= 5
    ranges = parse_ranges(texts, scene)
    check_ranges(scene, ranges)
    for item in ranges:
        assert item.share(math.sqrt(item.low * item.high)) == pytest.approx(0.5)
    with Playground(scene, ranges, 1.0, "") as ground:
        assert ground._shares() == pytest.approx([0.5] * len(ranges))


def test_the_spheroid_has_the_sliders_of_its_biology():
    keys = [key.rpartition(".")[2] for key in default_ranges(mc.load_scene("spheroid"))]
    assert keys == ["boundary", "uptake", "quiescence", "necrosis", "cycle_time"]


@pytest.mark.parametrize(
    ("key", "text", "label"),
    [
        (KEY, "1:21 %", "21 %"),
        (KEY, "10:160 mmHg", "160 mmHg"),
        (KEY, "0.01:0.2", "0.2 mM"),
        ("growth.cycle_time", "8:30 h", "30 h"),
        ("growth.cycle_time", "1:2 d", "2 d"),
        ("growth.cycle_time", "36000:72000", "20 h"),
        ("drag.viscosity", "log 0.1:10 kPa s", "10 kPa s"),
        ("drag.viscosity", "log 1e2:1e4 Pa s", "1e+04 Pa s"),
    ],
)
def test_labels_have_the_unit_that_was_asked_for(key, text, label):
    scene = mc.load_scene("spheroid")
    ranges = parse_ranges({key: text}, scene)
    with Playground(scene, ranges, 1.0, "", units=asked_units({key: text}, ranges)) as ground:
        [slider] = ground.sliders()
        assert ground._label(ranges[0], ranges[0].high) == label
        number, _, unit = label.partition(" ")
        assert (slider["high"], slider["unit"]) == (pytest.approx(float(number)), unit)


HOUR, DAY = 3600.0, 86400.0


@pytest.mark.parametrize(
    ("times", "counts", "words"),
    [
        ([0, 7.5 * DAY, 9 * DAY], {"necrotic": [0, 3, 9], "quiescent": [1, 5, 9]},
         "necrosis begins on day 8"),
        ([0, 7.5 * DAY, 9 * DAY], {"necrotic": [0, 0, 0], "quiescent": [0, 0, 9]},
         "quiescence begins on day 10"),
        ([0, 2 * HOUR, 5 * HOUR], {"necrotic": [0, 1, 0]}, "necrosis begins after 2 h"),
        ([0, DAY, 9 * DAY], {"necrotic": [2, 1, 0]}, "necrosis begins at the start"),
        ([0, DAY], {"cells": [10, 25]}, "2.5 times as many cells, none quiescent or necrotic"),
        ([0, DAY], {"cells": [10, 10]}, "no growth, no cell quiescent or necrotic"),
        ([0, DAY], {"cells": [10, 4]}, "fewer cells than at first"),
    ],
)  # fmt: skip
def test_a_run_has_a_verdict(times, counts, words):
    history = {"time": times, "cells": [1] * len(times), **counts}
    assert verdict({name: np.array(column, float) for name, column in history.items()}) == words


@pytest.mark.slow
def test_without_a_key_the_scene_as_it_is_begins_at_once(tmp_path):
    with served(tmp_path, SMALL[:6]) as (_, found):
        status = wait_for(found, lambda s: not s["going"])
    assert (status["number"], status["part"]) == (1, 1.0)
    assert "cells" in status["text"]
