"""Sentences of a paper on a run follow from the run."""

from __future__ import annotations

import json
import re

import pytest
from click.testing import CliRunner

import multicell as mc
from multicell.cli.main import main


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    scene = mc.load_scene("growth").with_changes(
        {"duration": "2 h", "initial.count": 2, "growth.cycle_time": "20 h", "seed": 7,
         "integrator": "rkc2"}
    )  # fmt: skip
    return mc.run(scene, output=tmp_path_factory.mktemp("cite") / "run", report=False)


def test_every_citation_has_an_entry_and_every_entry_is_cited(run):
    found = run.cite()
    cited = {k for text in re.findall(r"\[([a-z0-9, ]*)\]", found.text) for k in text.split(", ")}
    assert cited == set(re.findall(r"@\w+\{(\w+),", found.bibtex))
    assert {"multicell", "johnson1971", "sommeijer1998", "salmon2011"} <= cited
    assert "hindmarsh2005" not in cited
    assert found.bibtex.count("{") == found.bibtex.count("}")
    assert f"version = {{{mc.__version__}}}" in found.bibtex


def test_the_text_has_values_with_units_seed_steps_and_versions(run):
    text = run.cite().text
    assert "growth.cycle_time = 72000 s" in text
    assert "of the seed 7" in text
    steps = run.summary()["steps"]
    assert f"2 h were simulated in {steps} coupling steps" in text
    assert "method 'rkc2'" in text
    for name, version in run.summary()["versions"].items():
        assert f"{name} {version}" in text
    hertz = run.scene.with_changes({"contact": {"law": "hertz"}, "duration": "1 h"})
    assert "hertz1882" in mc.run(hertz).cite().bibtex


def test_the_command_prints_text_or_entries(run):
    said = CliRunner().invoke(main, ["cite", str(run.folder)])
    assert said.output.rstrip() == run.cite().text
    said = CliRunner().invoke(main, ["cite", str(run.folder), "--bibtex"])
    assert said.output.startswith("@software{multicell")
    said = CliRunner().invoke(main, ["cite", str(run.folder), "--json"])
    assert json.loads(said.output) == {"text": run.cite().text, "bibtex": run.cite().bibtex}


def test_a_result_draws_itself_and_its_history_begins_with_time(run, tmp_path):
    assert len(run.plot().axes) >= 2
    mc.export(run, tmp_path, tables=["history"])
    assert (tmp_path / "history.csv").read_text().startswith("time_s,")
