"""Blocks of commands and of Python on the pages of the documentation, and how tests run them.

A comment before a block (``% test: ...`` in MyST, ``<!-- test: ... -->`` in the README), one or
several of them, says how a test runs it:

``no, REASON``
    not at all
``file NAME``
    not at all, but its text is the file that later blocks use
``copy PATH [NAME]``
    after a copy of a file of the repository (with ``NAME`` of that name) in the folder
``OLD -> NEW``
    with another text in place of one that stands there
``--option ...``
    with further options at the end of every ``multicell`` command that has them
``TEXT: --option ...`` or ``TEXT: no, REASON``
    the same for commands only that contain a text

What a ``pip`` or ``python -m venv`` does is for the whole installation to test, and is left out.
All blocks of a page run one after the other in one folder, which has the repository's examples.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import click
from click.testing import CliRunner

import multicell
from multicell.cli.main import main

ROOT = Path(__file__).parents[2]
PACKAGE = Path(multicell.__file__).parents[1]
"""Where the package is that tests import; for that of another folder all would be compiled anew."""
SHELL = ("sh", "bash", "shell", "console")
_FENCE = re.compile(r"^(?P<indent> *)(?P<fence>`{3,}|~{3,})(?P<language>[^`\n]*)$")
_COMMENT = re.compile(r"^(?:% test:|<!-- *test:) *(?P<text>.*?) *(?:-->)?$")
_INSTALLS = re.compile(r"^(\.venv/bin/)?pip3? install |^python3? -m venv ")


@dataclass
class Block:
    line: int
    language: str
    text: str
    ways: list[str] = field(default_factory=list)


@dataclass
class Ways:
    reason: str = ""
    name: str = ""
    copies: list[list[str]] = field(default_factory=list)
    replaced: list[tuple[str, str]] = field(default_factory=list)
    chosen: list[tuple[str, str]] = field(default_factory=list)


def pages() -> list[Path]:
    found = [file for file in sorted((ROOT / "docs").rglob("*.md")) if "gallery" not in file.parts]
    return [*(ROOT / name for name in ("README.md", "CONTRIBUTING.md") if (ROOT / name).exists()),
            *found]  # fmt: skip


def blocks(text: str) -> Iterator[Block]:
    ways: list[str] = []
    lines = iter(enumerate(text.splitlines(), 1))
    for number, line in lines:
        if comment := _COMMENT.match(line.strip()):
            ways.append(comment["text"])
        elif fence := _FENCE.match(line):
            inside = [line for _, line in _until(lines, fence["fence"])]
            cut = len(fence["indent"])
            text = "\n".join(line[cut:] for line in inside)
            yield Block(number, fence["language"].strip(), text, ways)
            ways = []
        elif line.strip() and ways:
            raise ValueError(f"line {number}: no block follows {ways}")


def _until(lines: Iterator[tuple[int, str]], fence: str) -> Iterator[tuple[int, str]]:
    """Yield lines up to the end of a block."""
    for number, line in lines:
        if line.strip().startswith(fence) and not line.strip().strip(fence[0]):
            return
        yield number, line
    raise ValueError("a block has no end")


def ways_of(block: Block) -> Ways:
    ways = Ways()
    for text in block.ways:
        if text.startswith("no,"):
            ways.reason = text[3:].strip()
        elif text.startswith("file "):
            ways.name = text[5:].strip()
        elif text.startswith("copy "):
            ways.copies.append(text.split()[1:])
        elif " -> " in text:
            ways.replaced.append(tuple(text.split(" -> ")))  # type: ignore[arg-type]
        else:
            which, _, what = ("", "", text) if text.startswith("--") else text.partition(": ")
            if not what.startswith(("--", "no,")):
                raise ValueError(f"line {block.line}: what is {text!r} to a test?")
            ways.chosen.append((which, what))
    return ways


def commands(text: str) -> list[str]:
    """Return the commands of a shell block without remarks, each on one line."""
    joined = re.sub(r"\s*\\(\s+#[^\n]*)?\n\s*", " ", text)
    found = []
    for line in joined.splitlines():
        bare = line.removeprefix("$ ").strip()
        parts = bare[: _remark(bare)].split(" && ")
        found += [part.strip() for part in parts if part.strip()]
    return found


def _remark(line: str) -> int:
    """Return where the remark at the end of a line begins."""
    quote = ""
    for place, letter in enumerate(line):
        if quote:
            quote = "" if letter == quote else quote
        elif letter in "'\"":
            quote = letter
        elif letter == "#" and (place == 0 or line[place - 1].isspace()):
            return place
    return len(line)


def planned(block: Block) -> list[tuple[str, str]]:
    """Return the commands of a shell block as they are run, each with why it is not, or nothing."""
    ways, text, found = ways_of(block), block.text, []
    for old, new in ways.replaced:
        if old not in text:
            raise ValueError(f"line {block.line}: the block has no {old!r}")
        text = text.replace(old, new)
    for command in commands(text):
        reason = ways.reason
        if _INSTALLS.match(command):
            reason = reason or "installing is tested as a whole"
        for which, what in ways.chosen:
            if which and which not in command:
                continue
            if what.startswith("no,"):
                reason = what[3:].strip()
            elif _has_options(command, what):
                command = f"{command} {what}"
        found.append((command, reason))
    unused = [which for which, _ in ways.chosen if not any(which in line for line, _ in found)]
    if unused:
        raise ValueError(f"line {block.line}: no command has {unused}")
    return found


def command_of(words: list[str]) -> click.Command:
    """Return the command of ``multicell`` that words on a command line mean.

    Raises
    ------
    LookupError
        If there is none.
    """
    found: click.Command = main
    for word in words:
        if not isinstance(found, click.Group):
            break
        inner = found.get_command(click.Context(found), word)
        if inner is not None:
            found = inner
        elif not word.startswith("-"):
            raise LookupError(f"multicell has no command {word!r}")
    return found


def options_of(command: click.Command) -> set[str]:
    own = {name for option in command.params for name in [*option.opts, *option.secondary_opts]}
    return own | {"-h", "--help"}


def _has_options(command: str, options: str) -> bool:
    """Return whether a command line is one of ours that has all these options."""
    words = shlex.split(command)
    if not words or words[0] not in {"multicell", ".venv/bin/multicell"}:
        return False
    asked = {word.partition("=")[0] for word in shlex.split(options) if word.startswith("--")}
    return asked <= options_of(command_of(words[1:]))


def run(command: str, folder: Path) -> None:
    """Run a command in the current folder, ours in this process; raise where it fails."""
    command = re.sub(r"^\.venv/bin/", "", command)
    words = shlex.split(command)
    if words[0] == "multicell" and not set(words) & {"|", ">", "<", "||", ";", "&"}:
        answer = CliRunner().invoke(main, words[1:])
        if answer.exit_code:
            said = f"{answer.output}{answer.exception!r}"
            raise AssertionError(f"{command!r} ended with {answer.exit_code}: {said}")
        return
    done = subprocess.run(command, shell=True, cwd=folder, env=_environment(folder), check=False,
                          capture_output=True, text=True, timeout=300)  # fmt: skip
    if done.returncode:
        raise AssertionError(f"{command!r} ended with {done.returncode}: {done.stderr}")


def run_page(page: Path, folder: Path) -> None:
    """Run all blocks of a page, one after the other, in the current folder."""
    names: dict[str, object] = {"__name__": "page"}
    for block in blocks(page.read_text("utf-8")):
        if "{" in block.language:  # for Sphinx
            continue
        ways, text = ways_of(block), block.text
        for source, *other in ways.copies:
            shutil.copy(ROOT / source, other[0] if other else Path(source).name)
        if ways.name:
            Path(ways.name).write_text(text + "\n", "utf-8")
        elif block.language in SHELL:
            for command, reason in planned(block):
                if not reason:
                    run(command, folder)
        elif block.language == "python" and not ways.reason:
            for old, new in ways.replaced:
                assert old in text, f"line {block.line}: the block has no {old!r}"
                text = text.replace(old, new)
            exec(compile("\n" * block.line + text, str(page), "exec"), names)


def _environment(folder: Path) -> dict[str, str]:
    """Return the environment of commands in which ``multicell`` and ``python`` are these here."""
    place = folder / ".bin"
    place.mkdir(exist_ok=True)
    for name, words in {"multicell": "-m multicell", "python": "", "python3": ""}.items():
        (place / name).write_text(f'#!/bin/sh\nexec "{sys.executable}" {words} "$@"\n')
        (place / name).chmod(0o755)
    paths = {"PATH": place, "PYTHONPATH": PACKAGE}
    before = {name: os.environ.get(name, "") for name in paths}
    joined = {name: os.pathsep.join([str(paths[name]), before[name]]) for name in paths}
    return {**os.environ, **joined, "BROWSER": "true"}


if __name__ == "__main__":  # in a plain environment, which has no pytest
    run_page(Path(sys.argv[1]).resolve(), Path.cwd())
