"""The door: any input, any streams, and at the end one line and the right exit code."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from click.testing import CliRunner

from multicell.cli import options as cli_common
from multicell.cli import process as door
from multicell.cli.main import main
from multicell.errors import ExitCode

SETTLE = ("settle", "--set", "initial.count=4", "--set", "duration=2 min", "--no-report")
FULL = Path("/dev/full")


def call(*arguments):
    return CliRunner().invoke(main, [str(item) for item in arguments])


def process(*arguments, env=None, **streams):
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | streams
    return subprocess.run(
        [sys.executable, "-m", "multicell", *map(str, arguments)],
        env={**os.environ, **(env or {})}, check=False, timeout=120, **streams,
    )  # fmt: skip


def one_error(answer, code=2):
    """Assert one error line on stderr, of ours, and nothing of the last resort."""
    assert answer.exit_code == code, answer.output
    lines = [line for line in answer.stderr.splitlines() if line.startswith("Error: ")]
    assert len(lines) == 1, answer.stderr
    assert "Traceback" not in answer.output
    assert "bug of multicell" not in answer.stderr
    assert isinstance(answer.exception, SystemExit)
    return lines[0]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("door") / "out"
    answer = call("run", *SETTLE, "-o", out, "--quiet")
    assert answer.exit_code == 0, answer.output
    return out


# values of --set

DIGITS = "9" * 5000
VALUES = [
    DIGITS, f"-{DIGITS}", f"[{DIGITS}]", f"{{a = {DIGITS}}}", f"0.{DIGITS}", f"1e{DIGITS}",
    "[" * 10_000 + "]" * 10_000, "[" * 200 + "]" * 200, "{a = " * 10_000 + "1" + "}" * 10_000,
    "[" * 10_000, "1979-05-27", "07:32:00", "1979-05-27T07:32:00Z", "{a = 1}", "{}", "[]", "[[]]",
    "{a = {b = {c = 1979-05-27}}}", "[1, [2, 1979-05-27]]", "true", "nan", "inf", "-inf", "1e999",
    "\x00", "\udcff", "'\udcff'", "\U0001f9eb", "µm", "1 µm µm", '"""', "'", '"', "\\", "= 1",
    "1 = 2", "5 kPa\nb = 2", "x" * 100_000, "0x10", "1_000", "#", "1 # comment", "[1,]",
]  # fmt: skip
KEYS = [
    "duration", "seed", "initial", "growth", "nutrients", "nutrients.oxygen.boundary",
    "nutrients.oxygen.media", "integrator", "contact.law", "growth.phases",
]  # fmt: skip


@pytest.mark.parametrize("key", KEYS)
def test_any_value_of_any_kind_is_taken_or_refused_with_its_key(key):
    from multicell.errors import SceneError
    from multicell.scene.scene import load_scene

    refused, scene = [], load_scene("spheroid")
    for value in VALUES:
        try:
            scene.with_changes(cli_common.parse_changes([f"{key}={value}"]))
        except SceneError as error:
            refused.append(str(error))
    assert len(refused) > 0
    assert all(key.split(".")[0] in text and len(text) < 1000 for text in refused)


@pytest.mark.parametrize("value", [DIGITS, "[" * 10_000 + "]" * 10_000, "\udcff"])
def test_a_value_that_cannot_be_read_is_named_by_its_key(value):
    line = one_error(call("explain", "settle", "--set", f"drag.viscosity={value}"))
    assert "drag.viscosity" in line
    assert len(line) < 300


def test_the_last_of_repeated_keys_counts_at_its_place():
    items = ["growth=", "growth.cycle_time=15 h", "growth="]
    assert list(cli_common.parse_changes(items).items()) == [
        ("growth.cycle_time", "15 h"),
        ("growth", None),
    ]


@pytest.mark.parametrize("key", ["", " ", ".", "a..b", ".a", "a.", "\udcff", "x" * 10_000, "a b"])
def test_keys_that_are_none_are_refused(key):
    line = one_error(call("explain", "settle", "--set", f"{key}=1"))
    assert len(line) < 300 + len(key)


# encodings and streams

COMMANDS = [
    ["--help"],
    ["scenes"],
    ["explain", "spheroid"],
    ["compare", "--help"],
    ["explain", "nonsense"],
    ["explain", "spheroid", "--json", "--set", "title=µ→²"],
]


@pytest.mark.parametrize("arguments", COMMANDS, ids=" ".join)
def test_output_fits_a_narrow_encoding(arguments):
    encoding = "latin-1" if "scenes" in arguments else "ascii"
    done = process(*arguments, env={"PYTHONIOENCODING": encoding, "NO_COLOR": "1", "COLUMNS": "60"})
    assert done.returncode == (2 if "nonsense" in arguments else 0), done.stderr
    assert b"Traceback" not in done.stderr
    text = done.stdout.decode(encoding)
    if "--json" in arguments:
        assert json.loads(text)["title"] == "µ→²"
    if arguments == ["explain", "spheroid"]:
        assert "Damk?hler" in text


@pytest.mark.slow
def test_runs_print_in_ascii(tmp_path):
    env = {"PYTHONIOENCODING": "ascii"}
    out = tmp_path / "µ→out"
    for code in (0, 2):
        done = process("run", *SETTLE, "-o", out, env=env)
        assert b"Traceback" not in done.stderr
        shown = (done.stdout + done.stderr).decode("ascii")
        assert done.returncode == code, shown
    assert "not empty" in shown


@pytest.mark.slow
@pytest.mark.skipif(not FULL.exists(), reason="there is no device that is always full")
@pytest.mark.parametrize("arguments", [COMMANDS[0], *COMMANDS[-2:]], ids=" ".join)
def test_full_output_ends_with_one_line(arguments):
    with FULL.open("wb") as full:
        done = process(*arguments, stdout=full)
        lines = done.stderr.decode().splitlines()
        if "nonsense" in arguments:
            assert done.returncode == 2
        else:
            assert done.returncode == ExitCode.MACHINE
            assert lines == ["Error: the output cannot be written: No space left on device"]
        quiet = process(*arguments, stderr=full)
        assert quiet.returncode == (2 if "nonsense" in arguments else 0)


@pytest.mark.skipif(not FULL.exists(), reason="there is no device that is always full")
@pytest.mark.slow
def test_a_run_outlives_a_full_log(tmp_path):
    with FULL.open("wb") as full:
        done = process("run", *SETTLE, "-o", tmp_path / "o", stderr=full)
    assert done.returncode == 0
    assert (tmp_path / "o" / "summary.json").exists()
    assert "interrupted" not in json.loads((tmp_path / "o" / "summary.json").read_text())


@pytest.mark.parametrize("arguments", COMMANDS[1:3], ids=" ".join)
def test_a_pipe_that_nobody_reads_ends_quietly(arguments):
    reader, writer = os.pipe()
    os.close(reader)
    try:
        done = process(*arguments, stdout=writer)
    finally:
        os.close(writer)
    assert done.returncode == ExitCode.MACHINE
    assert done.stderr == b""


@pytest.mark.slow
@pytest.mark.parametrize("closed", [(1,), (0, 1, 2)])
def test_closed_streams_do_not_reach_the_results(closed, tmp_path):
    """A file that is opened next must not become standard output for C libraries."""

    def close():
        for number in closed:
            os.close(number)

    done = process("run", *SETTLE, "-o", tmp_path / "o", preexec_fn=close)
    assert done.returncode == 0
    assert b"Traceback" not in done.stderr
    assert len(call("export", tmp_path / "o", "-o", tmp_path / "t").output.splitlines()) >= 3


# what is no file


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="there are no devices here")
@pytest.mark.parametrize("command", ["explain", "run"])
def test_what_never_ends_is_no_scene(command, tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with (tmp_path / "huge.toml").open("wb") as file:
        file.truncate(5_000_000_000)
    output = ["-o", tmp_path / "o"] if command == "run" else []
    begin = time.monotonic()
    for source, words in (
        ("/dev/zero", "no regular file"),
        ("/dev/null", "no regular file"),
        ("/dev/stdin", "scene"),
        (tmp_path / "pipe", "no regular file"),
        (tmp_path / "huge.toml", "larger than 10 MB"),
        (tmp_path, "is a folder, not a scene"),
        ("/dev/null/scene.toml", "ot a directory"),
        ("x" * 5000 + ".toml", "cannot be read"),
        ("a\x00b.toml", "cannot be read"),
        ("\udcff.toml", "does not exist"),
        ("", "a scene without a name"),
        (".", "is a folder, not a scene"),
    ):
        line = one_error(call(command, source, *output))
        assert words in line, source
    assert time.monotonic() - begin < 20
    assert not (tmp_path / "o").exists()


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="there are no devices here")
@pytest.mark.parametrize(
    "place", ["/dev/null", "/dev/zero", "nowhere", "file", "pipe", "", "\udcff"]
)
@pytest.mark.parametrize("command", ["resume", "export"])
def test_what_is_no_folder_holds_no_results(command, place, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("file").write_text("not a folder")
    os.mkfifo("pipe")
    one_error(call(command, place, "-o", tmp_path / "o"))
    assert not (tmp_path / "o").exists()


@pytest.mark.parametrize(
    "place", ["file", "file/below", "/dev/null", "/dev/null/below", "x" * 5000]
)
@pytest.mark.parametrize("command", ["run", "compare", "export"])
def test_what_is_no_place_for_results_is_refused(command, place, folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("file").write_text("mine")
    source = folder if command == "export" else "settle"
    one_error(call(command, source, "-o", place))
    assert Path("file").read_text() == "mine"


# wrong on purpose

WRONG = [
    ["explain"], ["explain", "settle", "more"], ["explain", "settle", "--json=5"],
    ["explain", "nonsense"], ["run", "settle", "-o", "o", "--threads", "100000"],
    ["run", "settle", "-o", "o", "--integrator", ""],
    ["run", "settle", "-o", "o", "--integrator", "\udcff"],
    ["resume", "FOLDER", "--frame", "-99"], ["resume", "FOLDER", "--set", "seed=7"],
    ["resume", "FOLDER", "--set", "duration=1 s"], ["resume", "FOLDER", "--integrator", "euler"],
    ["export", "FOLDER", "-o", "o", "--tables", "nothing"],
    ["export", "FOLDER", "-o", "o", "--tables", ","],
    ["export", "FOLDER", "-o", "o", "--frame", "99"],
    ["export", "FOLDER", "-o", "o", "--frame", "9" * 30],
    ["compare", "settle", "-o", "o", "--methods", "rk5"],
    ["compare", "settle", "-o", "o", "--methods", "\udcff"],
    ["stability", "settle", "-o", "o", "--methods", ","],
    ["compare", "settle", "-o", "o", "--stepwise", "0"],
    ["compare", "settle", "-o", "o", "--budget", "-1"],
    ["compare", "settle", "-o", "o", "--budget", "nan"], ["nonsense"], ["run", "--nonsense"],
]  # fmt: skip


@pytest.mark.parametrize(
    "arguments", WRONG, ids=lambda a: " ".join(a)[:60].encode("ascii", "replace").decode()
)
def test_wrong_input_ends_with_2_and_one_line(arguments, folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    given = [str(folder) if item == "FOLDER" else item for item in arguments]
    one_error(call(*given))
    assert not Path("o").exists()
    answer = call(*given, "--json")
    assert answer.exit_code == 2
    assert json.loads(answer.stdout)["error"] in answer.stderr


# interrupts and the last resort


@pytest.mark.parametrize("delay", [0.3, 2.4])
@pytest.mark.slow
def test_ctrl_c_at_any_moment(delay, tmp_path):
    # what happens before the first line of ours is the interpreter's own
    program = "from multicell.__main__ import run; print('on', flush=True); run()"
    going = subprocess.Popen(
        [sys.executable, "-c", program, "run", "growth", "-o", str(tmp_path / "o"),
         "--set", "initial.count=200", "--set", "duration=60 d", "--set", "output.every=1 d"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip
    assert going.stdout.readline() == "on\n"
    time.sleep(delay)
    going.send_signal(signal.SIGINT)
    _, errors = going.communicate(timeout=120)
    assert going.returncode == 130
    assert errors.splitlines()[-1] == "Interrupted."
    assert "Traceback" not in errors


def test_ctrl_c_while_modules_are_loaded():
    program = (
        "import sys\n"
        "class Press:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name == 'multicell.cli.main':\n"
        "            raise KeyboardInterrupt\n"
        "sys.meta_path.insert(0, Press())\n"
        "from multicell.__main__ import run\n"
        "run()\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "Interrupted.\n")


@pytest.mark.parametrize("error", [KeyError("x"), RecursionError("deep"), ValueError("a\nb")])
def test_an_unexpected_error_is_one_line_that_says_what_to_do(error, monkeypatch):
    def broken(*arguments, **options):
        raise error

    monkeypatch.setattr("multicell.report.explain.scene.explain", broken)
    monkeypatch.delenv(door.DEBUG, raising=False)
    answer = call("explain", "settle", "--json")
    assert answer.exit_code == ExitCode.BUG
    (line,) = answer.stderr.splitlines()
    assert "bug of multicell" in line
    assert door.DEBUG in line
    assert type(error).__name__ in line
    assert json.loads(answer.stdout)["kind"] == type(error).__name__
    monkeypatch.setenv(door.DEBUG, "1")
    assert "Traceback" in call("explain", "settle").stderr


def test_errors_of_the_system_name_the_file():
    words, code = door.error_in_words(PermissionError(13, "Permission denied", "somewhere"))
    assert (words, code) == ("'somewhere' cannot be used: Permission denied", 3)
    assert door.error_in_words(MemoryError()) == ("there is not enough memory for this", 3)
