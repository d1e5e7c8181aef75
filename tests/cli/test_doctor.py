"""``multicell doctor``: what it tells is what there is."""

import json
import os
from importlib import metadata

import pytest
from click.testing import CliRunner

from multicell import __version__
from multicell.cli.main import main
from multicell.host import extras as doctor


@pytest.fixture
def installed(monkeypatch):
    """A made-up installation: numpy is there, pandas is not."""
    known = {"multicell": __version__, "numpy": metadata.version("numpy")}
    wanted = ["numpy>=2.0", 'pandas>=2.2; extra == "export"', 'numpy; extra == "study"',
              'ruff; extra == "dev"']  # fmt: skip

    def version(name):
        if name not in known:
            raise metadata.PackageNotFoundError(name)
        return known[name]

    monkeypatch.setattr(metadata, "requires", lambda _: wanted)
    monkeypatch.setattr(metadata, "version", version)
    return known


def test_versions_and_missing_packages_are_told(installed):
    done = CliRunner().invoke(main, ["doctor", "--json"])
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert found["versions"] == installed
    assert found["missing"] == {"export": ["pandas"]}
    assert found["cores"] == os.cpu_count()
    assert 1 <= found["threads"] <= found["cores"]
    assert found["memory_GiB"] > 0.1


def test_the_table_says_how_to_get_what_is_missing(installed):
    done = CliRunner().invoke(main, ["doctor"])
    assert done.exit_code == 0, done.output
    text = " ".join(done.stdout.split())
    assert f"multicell {__version__}" in text
    assert 'lacks pandas: pip install ".[export]"' in text


def test_a_cache_that_cannot_be_written_to_is_told(installed, monkeypatch, tmp_path):
    monkeypatch.setattr(doctor.os, "access", lambda *_: False)
    done = CliRunner().invoke(main, ["doctor"])
    assert "set NUMBA_CACHE_DIR to a folder of your own" in " ".join(done.stdout.split())


def test_sources_that_are_not_installed_know_no_packages(monkeypatch):
    def absent(name):
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(metadata, "requires", absent)
    monkeypatch.setattr(metadata, "version", absent)
    found = doctor.checkup()
    assert (found["versions"], found["missing"]) == ({"multicell": __version__}, {})
