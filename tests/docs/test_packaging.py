"""Recipe, container and workflow build what pyproject.toml describes, from the checkout."""

import importlib
import re
import shutil
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


# what the owner publishes


@pytest.fixture
def publish(monkeypatch):
    """Return the program that writes badges and addresses."""
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "packaging"))
    return importlib.import_module("publish")


def test_badges_state_what_the_package_says(publish):
    readme = (ROOT / "README.md").read_text("utf-8")
    found = publish.facts(PROJECT)
    assert set(found) == {"version", "python", "license"}
    for name, value in found.items():
        path = f"docs/static/badges/{name}.svg"
        assert (ROOT / path).read_text("utf-8") == publish.badge(name, value)
        alternative = re.search(rf"!\[([^\]]+)\]\({re.escape(path)}\)", readme)[1]
        assert alternative.lower() == f"{name} {value}".lower()


def test_address_is_written_wherever_it_is_needed_and_can_be_changed(publish, tmp_path):
    yaml = pytest.importorskip("yaml")
    names = ("pyproject.toml", "CITATION.cff", ".github/ISSUE_TEMPLATE/config.yml")
    for name in names:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    with pytest.raises(ValueError, match="is no address"):
        publish.write_address("example.org", tmp_path)
    for owner in ("first", "second"):
        address = f"https://example.org/{owner}/multicell"
        publish.write_address(address, tmp_path)
        project = publish.project(tmp_path)
        assert project["urls"]["Issues"] == f"{address}/issues"
        assert {key: project[key] for key in PROJECT} == PROJECT
        citation, links = (yaml.safe_load((tmp_path / n).read_text("utf-8")) for n in names[1:])
        assert citation["repository-code"] == address
        assert links["contact_links"][0]["url"] == f"{address}/security"
        assert links["blank_issues_enabled"] is False
    assert "first" not in "".join((tmp_path / name).read_text("utf-8") for name in names)


def test_forms_of_issues_ask_for_what_is_needed():
    yaml = pytest.importorskip("yaml")
    folder = ROOT / ".github" / "ISSUE_TEMPLATE"
    forms = {path.stem: yaml.safe_load(path.read_text("utf-8")) for path in folder.glob("*.yml")}
    assert set(forms) == {"bug", "idea", "question", "config"}
    for name in set(forms) - {"config"}:
        inputs = [part for part in forms[name]["body"] if part["type"] != "markdown"]
        assert len({part["id"] for part in inputs}) == len(inputs)
        assert any(part.get("validations", {}).get("required") for part in inputs)
        assert {"name", "description", "labels"} <= set(forms[name])
    commands = re.findall(r"`(multicell \w+)`", str(forms))
    assert commands == ["multicell doctor"]


def test_only_sets_of_extras_are_installed_by_name():
    """The package is on no index: it comes from its folder, and then its extras by name."""
    texts = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    found = {
        (path.name, line)
        for path in texts
        for line in path.read_text("utf-8").splitlines()
        if re.search(r"pip install [\"\']?multicell(?!\[)", line)
    }
    assert found == set()
    named = {
        extra
        for path in texts
        for group in re.findall(r"multicell\[([\w,]+)\]", path.read_text("utf-8"))
        for extra in group.split(",")
    }
    assert named - {"NAME"} <= set(PROJECT["optional-dependencies"])
