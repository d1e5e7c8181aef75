"""Every command and every block of Python on the pages runs, or says why it is not run here."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import matplotlib as mpl
import page_commands
import pytest
from page_commands import ROOT, SHELL, blocks, pages, planned

import multicell as mc

PAGES = {str(page.relative_to(ROOT)): page for page in pages()}
KNOWN = {
    "", "bibtex", "json", "mermaid", "python", "text", "toml", "xml", "yaml", *SHELL,
}  # fmt: skip
"""Languages of blocks; others, and all in braces, are for Sphinx."""
RUN = [
    name
    for name, page in PAGES.items()
    if any(block.language in {"python", *SHELL} for block in blocks(page.read_text("utf-8")))
]


def told(page: Path) -> list[page_commands.Block]:
    return [block for block in blocks(page.read_text("utf-8")) if "{" not in block.language]


@pytest.mark.slow
@pytest.mark.parametrize("name", RUN)
def test_what_a_page_says_runs(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("BROWSER", "true")
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    with mpl.rc_context({"backend": "agg"}):
        page_commands.run_page(PAGES[name], tmp_path)


@pytest.mark.parametrize("name", PAGES)
def test_all_blocks_are_of_a_kind_that_is_known(name):
    for block in told(PAGES[name]):
        assert block.language in KNOWN, f"line {block.line}"
        if block.language in {"", "text"}:
            commands = re.findall(r"^(?:\$ )?multicell .*", block.text, re.MULTILINE)
            assert commands == [], f"line {block.line}: commands are in blocks of 'sh'"
        # a reason is one that a reader can judge
        reasons = [reason for _, reason in planned(block)] if block.language in SHELL else []
        assert all(len(reason.split()) > 2 for reason in reasons if reason), f"line {block.line}"


SPAN = re.compile(r"(?<!`)`([^`\n]+)`(?!`)")


def spans(page: Path) -> list[str]:
    """Return the inline code of a page."""
    text = re.sub(r"^( *)(`{3,}).*?^\1\2`*$", "", page.read_text("utf-8"), flags=re.S | re.M)
    return SPAN.findall(text)


@pytest.mark.parametrize("name", PAGES)
def test_commands_within_the_text_exist_with_their_options(name):
    for span in spans(PAGES[name]):
        if not span.startswith("multicell ") or "…" in span or "..." in span:
            continue
        for alternative in span.removeprefix("multicell ").split(" | "):
            words = [word for word in alternative.split() if not re.fullmatch(r"[A-Z|]+", word)]
            try:
                words = shlex.split(" ".join(words))
            except ValueError:
                continue
            command = page_commands.command_of(words)
            asked = {word.partition("=")[0] for word in words if re.match(r"--?[a-z]", word)}
            assert asked <= page_commands.options_of(command), span


@pytest.mark.parametrize("name", PAGES)
def test_names_of_the_package_within_the_text_exist(name):
    for span in spans(PAGES[name]):
        if found := re.match(r"(?:mc|multicell)\.([A-Za-z_]+)(?:\.([A-Za-z_]+))?", span):
            module = (
                found[1] if (ROOT / "multicell" / found[1]).with_suffix(".py").is_file() else ""
            )
            if module or (ROOT / "multicell" / found[1]).is_dir():
                continue
            home = getattr(mc, found[1])
            if found[2] and isinstance(home, type):
                assert found[2] in {*dir(home), *home.__annotations__}, span


@pytest.mark.parametrize("name", [*PAGES, "CHANGELOG.md"])
def test_files_named_within_the_text_exist(name):
    for span in spans(ROOT / name):
        if re.fullmatch(r"(docs|examples|tests|multicell)/[\w/.-]+\.\w+", span):
            assert (ROOT / span).exists(), span
