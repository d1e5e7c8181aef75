"""Text of files of others: whatever it holds, messages and pages are printable."""

from contextlib import closing

import forged
import h5py
import pytest
from click.testing import CliRunner
from synthetic import SCENE, spheroid

import multicell as mc
from multicell.cli.main import main
from multicell.errors import DataError, printable
from multicell.report.html import _environment
from multicell.results.documents import Lines, read_document
from multicell.results.journal import Reader
from multicell.results.reader import Contents
from multicell.results.writer import Store

BAD = (
    "\x1b[31mred\x1b[0m",
    "a\nb",
    "a\rb",
    "\x07",
    "\x9b1m",
    "\u202egnol",
    "\u2066x\u2069",
    "a\x00",
)
HALF = "a\ud800b"


@pytest.mark.parametrize("text", [*BAD, HALF])
def test_an_escaped_text_says_what_was_there(text):
    safe = printable(text)
    assert safe.isprintable()
    assert safe.encode().decode("unicode_escape").encode("utf-16", "surrogatepass") == text.encode(
        "utf-16", "surrogatepass"
    )
    assert printable(safe) == safe
    assert printable("µm ≥ 3, Zoë", lines=True) == "µm ≥ 3, Zoë"
    assert printable(f"{text}\nb", lines=True).splitlines()[-1] == "b"


@pytest.mark.parametrize("text", [*BAD, HALF])
def test_errors_are_printable_whatever_they_name(text):
    for error in (
        mc.SceneError(text, text, text), mc.OutputError(text), DataError(text, text, text),
        mc.StepFailed(0.0, text, text),
    ):  # fmt: skip
        assert str(error).isprintable()
        assert (error.problem + error.hint).isprintable()
        assert str(error).encode()


SCENES = (
    '"%s" = 3\n', '[types."%s"]\n[types.b]\n', '[nutrients."%s"]\nboundary = "1 mM"\n',
    'title = "%s"\n', '[contact]\nlaw = "%s"\n', '[initial]\nspacing = "%s"\n',
    '[networks."%s"]\nfile = "no"\n', '[networks.a]\nfile = "%s"\n', '[initial]\ncells = "%s"\n',
    '[output.observables."%s"]\nfunction = "a.py:f@0"\nunit = ""\n', 'seed = "%s"\n',
)  # fmt: skip


@pytest.mark.parametrize("bad", BAD)
@pytest.mark.parametrize("scene", SCENES)
def test_keys_and_values_of_a_scene_are_refused_in_printable_words(scene, bad, tmp_path):
    path = tmp_path / "scene.toml"
    written = "".join(f"\\u{ord(letter):04x}" for letter in bad)
    path.write_text('duration = "1 h"\n' + scene % written, "utf-8")
    done = CliRunner().invoke(main, ["explain", str(path)])
    assert done.exit_code == 2
    assert done.stderr.strip("\n").replace(str(tmp_path), "").isprintable()
    assert done.stdout == ""


@pytest.mark.parametrize("bad", BAD)
def test_measured_data_are_refused_in_printable_words(bad, tmp_path):
    path = tmp_path / "data.csv"
    for text in (f'"{bad}",diameter / um\n1,2\n', f'time / h,"{bad}"\n1,2\n',
                 f'time / h,diameter / um\n1,"{bad}"\n'):  # fmt: skip
        path.write_bytes(text.encode())
        done = CliRunner().invoke(
            main, ["fit", "growth", "--data", str(path), "--free", "growth.cycle_time=10:20 h",
                   "-o", str(tmp_path / "fit")],
        )  # fmt: skip
        assert done.exit_code == 2
        assert "data.csv" in done.stderr
        assert all(line.isprintable() for line in done.stderr.splitlines())


@pytest.mark.parametrize("name", [*BAD, HALF])
def test_names_in_result_files_are_printable_or_damage(name, tmp_path):
    with closing(Store.create(tmp_path / "out", SCENE)) as store:
        store.append_history({"time": 0.0, "cells": 1.0})
        store.append(spheroid(30))
    path = tmp_path / "out" / "frames.journal"
    data = path.read_bytes()
    for kind in ("rows", "frame"):
        path.write_bytes(data)
        kinds = [record.header["kind"] for record in Reader(path).records]

        def edit(header, body):
            header["arrays"][-1][0] = name
            return header, body

        forged.rewrite(path, kinds.index(kind), edit)
        damage = Contents(path.parent).damage
        assert damage.endswith("none of a run")
        assert damage.isprintable()


@pytest.mark.parametrize("name", [text for text in BAD if "\0" not in text])
@pytest.mark.parametrize("place", ["history", "fields"])
def test_names_in_hdf5_are_printable_or_damage(name, place, tmp_path):
    with closing(Store.create(tmp_path / "out", SCENE)) as store:
        store.append_history({"time": 0.0, "cells": 1.0})
        store.append(spheroid(30))
        store.settle()
    with h5py.File(tmp_path / "out" / "frames.h5", "r+") as file:
        if place == "history":
            rows = file["history"][()]
            about = dict(file["history"].attrs)
            del file["history"]
            table = file.create_dataset(
                "history", data=rows.astype([(name, "<f8"), ("time", "<f8")])
            )
            table.attrs.update(about)
        else:
            file.create_group(f"fields/{name.replace('/', '')}")
    with pytest.raises(mc.OutputError, match="are no names") as found:
        Contents(tmp_path / "out")
    assert found.value.damaged
    assert str(found.value).isprintable()


def test_halves_of_letters_in_documents_are_damage(tmp_path):
    path = tmp_path / "summary.json"
    for text in (b'{"a": "\\ud800", "checksum": "0"}', b'{"a": "\xed\xa0\x80", "checksum": "0"}'):
        path.write_bytes(text)
        with pytest.raises(mc.OutputError, match="damaged") as found:
            read_document(path)
        assert str(found.value).isprintable()
    lines = Lines(tmp_path / "log")
    lines.append([{"a": "\ud800"}])  # written as ASCII, with its checksum
    with pytest.raises(mc.OutputError, match="damaged in line 1"):
        Lines(tmp_path / "log")
    whole = Lines(tmp_path / "other")
    whole.append([{"a": "𝄞 µ"}])
    assert Lines(tmp_path / "other").entries == [{"a": "𝄞 µ"}]


@pytest.mark.parametrize("bad", [*BAD, HALF])
def test_pages_are_text_without_commands(bad):
    page = _environment().from_string("{{ x }}|{{ [x]|join }}|{{ n }}").render(x=bad, n=3)
    assert all(line.isprintable() for line in page.split("\n"))
    assert page.endswith("|3")
    assert page.encode()


@pytest.mark.parametrize("bad", BAD)
def test_a_summary_that_was_forged_moves_no_cursor(bad, tmp_path, capsys):
    from multicell.cli.options import console, key_table

    console().print(key_table([(bad, bad)]))
    shown = capsys.readouterr().out
    assert all(line.isprintable() for line in shown.split("\n"))


def test_arguments_come_back_printable():
    done = CliRunner().invoke(main, ["run", "growth", "-o", "x", "--set", "\x1b[31m"])
    assert done.exit_code == 2
    assert "'\\x1b[31m' is not KEY=VALUE" in done.stderr
