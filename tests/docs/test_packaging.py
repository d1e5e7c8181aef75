"""Recipe, container and workflow build what pyproject.toml describes, from the checkout."""

import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FILES = [
    ".ci/run",
    ".ci/lowest",
    ".github/workflows/ci.yml",
    "docs/packaging/Dockerfile",
    "docs/packaging/meta.yaml",
]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]


@pytest.mark.parametrize("name", FILES)
def test_no_host_and_no_place_of_a_machine_is_named(name):
    text = (ROOT / name).read_text("utf-8")
    assert not re.search(r"https?://|index-url|/(home|root|work|opt|Users)/", text)


def test_the_recipe_has_the_dependencies_of_the_package():
    text = (ROOT / "docs/packaging/meta.yaml").read_text("utf-8")
    run = text.partition("  run:\n")[2].partition("\ntest:")[0]
    found = {line.strip("- ").replace("matplotlib-base", "matplotlib").replace(" ", "")
             for line in run.splitlines()}  # fmt: skip
    assert found == {f"python{PROJECT['requires-python']}", *PROJECT["dependencies"]}
    (command,) = PROJECT["scripts"].items()
    assert " = ".join(command) in text
    pattern = re.search(r"regex_pattern='(.*)', from", text)[1]
    lines = (ROOT / "pyproject.toml").read_text("utf-8").splitlines()
    assert [m[1] for m in map(re.compile(pattern).match, lines) if m] == [PROJECT["version"]]


def test_the_container_copies_what_is_there_and_installs_extras_that_exist():
    text = (ROOT / "docs/packaging/Dockerfile").read_text("utf-8")
    for line in re.findall(r"^COPY (.*) \S+$", text, re.MULTILINE):
        assert all((ROOT / name).exists() for name in line.split())
    extras = re.search(r"/source\[(.*)\]", text)[1].split(",")
    assert set(extras) <= set(PROJECT["optional-dependencies"])


def test_the_workflow_calls_ci_on_three_systems_and_each_python():
    yaml = pytest.importorskip("yaml")
    text = (ROOT / ".github/workflows/ci.yml").read_text("utf-8")
    jobs = yaml.safe_load(text)["jobs"]
    matrix = jobs["systems"]["strategy"]["matrix"]
    assert {name.split("-")[0] for name in matrix["os"]} == {"ubuntu", "windows", "macos"}
    classified = re.findall(r"Python :: (3\.\d+)'", str(PROJECT["classifiers"]))
    assert matrix["python"] == classified
    commands = [step.get("run", "") for job in jobs.values() for step in job["steps"]]
    assert {command.split()[0] for command in commands if command} == {".ci/run", ".ci/lowest"}


def test_the_changelog_has_the_version_with_its_date():
    text = (ROOT / "CHANGELOG.md").read_text("utf-8")
    released = re.findall(r"^## \[(\d+\.\d+\.\d+)\] - \d{4}-\d\d-\d\d$", text, re.MULTILINE)
    assert released[0] == PROJECT["version"]
