"""``multicell compare --fields``: what it prints and what it refuses."""

import json

import pytest
from click.testing import CliRunner

from multicell.cli.main import main
from multicell.comparison.field_solvers import measure

SMALL = [
    "compare", "spheroid", "--set", "coupling_step=2 s", "--set", "duration=4 s", "--fields",
    "--spacings", "1", "--methods", "multicell-steady,multicell-implicit", "--repeats", "1",
    "--budget", "4",
]  # fmt: skip


@pytest.fixture(autouse=True)
def _small_map(monkeypatch):
    monkeypatch.setattr(measure, "UPTAKES", (1.0, 10.0))
    monkeypatch.setattr(measure, "TOLERANCES", (1e-2, 1e-1))


@pytest.mark.slow
def test_it_names_the_cheapest_solver(tmp_path):
    done = CliRunner().invoke(main, [*SMALL, "-o", str(tmp_path / "out")])
    assert done.exit_code == 0, done.output
    assert "oxygen, steady, cubes of" in done.stdout
    assert "within 1 %: multicell-steady" in done.stdout
    assert "Note: oxygen has no shells here" in done.stdout
    assert "Results are in" in done.stdout
    assert (tmp_path / "out" / "report.html").stat().st_size > 50_000
    again = CliRunner().invoke(main, [*SMALL, "-o", str(tmp_path / "out"), "--json"])
    assert again.exit_code == 2
    assert "--overwrite" in again.stderr


@pytest.mark.slow
def test_it_prints_the_table_as_json_at_a_later_time(tmp_path):
    done = CliRunner().invoke(
        main, [*SMALL, "-o", str(tmp_path / "out"), "--json", "--quiet", "--at", "2 s"]
    )
    assert done.exit_code == 0, done.output
    rows = json.loads(done.stdout)
    assert {row["solver"] for row in rows} == {"multicell-steady", "multicell-implicit"}
    assert {row["problem"] for row in rows} == {"steady", "transient", "switching medium"}
    held = json.loads((tmp_path / "out" / "field-solvers.json").read_text())
    assert held["facts"]["time"] == 2.0


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["spheroid", "--fields", "--stepwise"], "--stepwise compares methods of integration"),
        (["spheroid", "--fields", "--shift", "0.1"], "--shift compares methods of integration"),
        (["spheroid", "--at", "3 d"], "--at needs --fields"),
        (["spheroid", "--backend", "numpy"], "--backend needs --fields"),
        (["settle", "--fields"], "nutrients: are none: the scene has no fields"),
        (["spheroid", "--fields", "--methods", "euller"], "no solver of fields. Did you mean"),
        (["spheroid", "--fields", "--at", "soon"], "must be a number and a unit"),
        (["spheroid", "--fields", "--at", "9 y"], "at: "),
        (["spheroid", "--fields", "--spacings", "0"], "0 is not in the range"),
    ],
)
def test_wrong_input_is_refused_in_words(tmp_path, options, words):
    done = CliRunner().invoke(main, ["compare", *options, "-o", str(tmp_path / "out")])
    assert done.exit_code == 2
    assert words in done.stderr
    assert not (tmp_path / "out").exists()
