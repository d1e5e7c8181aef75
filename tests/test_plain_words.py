"""Plain English: turns of phrase that readers stumble over are on no page and in no text."""

import ast
import inspect
import io
import re
import tokenize
from pathlib import Path

import pytest
from page_commands import pages

import multicell
from multicell import testing
from multicell.cli.main import main

PACKAGE = Path(multicell.__file__).parent
DOCS = Path(__file__).parent.parent / "docs"
DIALECT = {
    r"\b(fore)?(tells?|told)\b": "reports, predicts, distinguishes",
    r"\b(goes|went|gone) on\b": "continues, resumed",
    r"\bheld against\b": "compared with",
    r"\b(gives|gave|give) way\b": "yields, is adapted",
    r"\bcells rest(ed)?\b": "are quiescent",
    r"\bof the random numbers\b": "of the random number streams",
    r"\bthe eye (stands|swings)\b": "viewing angle",
    r"\bit takes at least\b": "needs at least",
    r"\b(is|are) answered with\b": "gives",
    r"\b(can|could) be told\b": "is distinguishable",
}
QUESTION = re.compile(
    r"\bwhat (\w+ )?\w+ (do|does|makes?|finds?|has|have|holds?|means?|costs?)\b", re.I
)
"""A question in place of a noun."""
# from Python 3.12 on the text of an f-string is a token of its own
TEXTS = {tokenize.COMMENT, tokenize.STRING, getattr(tokenize, "FSTRING_MIDDLE", tokenize.STRING)}
RESULTS = {"CHANGELOG.md"}
"""Pages with the words of their time."""


def phrases(text):
    """Return the turns of phrase that a text has, each with the words to take."""
    found = [(re.search(p, text, re.I), better) for p, better in DIALECT.items()]
    return [f"{hit[0]!r}: {better}" for hit, better in found if hit]


def texts(path):
    """Yield comments, docstrings and other literal texts of a module, each with its line."""
    for token in tokenize.generate_tokens(io.StringIO(path.read_text("utf-8")).readline):
        if token.type in TEXTS:
            yield token.start[0], " ".join(token.string.split())


def test_texts_of_the_package_are_in_plain_words():
    found = [
        f"{path.relative_to(PACKAGE)}:{line}: {phrase}"
        for path in sorted(PACKAGE.rglob("*.py"))
        for line, text in texts(path)
        for phrase in phrases(text)
    ]
    assert found == []


def questions(path):
    """Return the places of a module where a comment or a text has a question for a noun."""
    return [f"{path}:{line}" for line, text in texts(path) if QUESTION.search(text)]


def test_comments_docstrings_and_messages_ask_no_questions():
    files = [*PACKAGE.rglob("*.py"), *(DOCS / "programs").glob("*.py")]
    assert len(files) > 400
    assert [place for path in sorted(files) for place in questions(path)] == []


def test_templates_and_scenes_are_in_plain_words():
    files = [*PACKAGE.rglob("*.html"), *PACKAGE.rglob("*.toml")]
    assert len(files) > 20
    for path in files:
        assert phrases(" ".join(path.read_text("utf-8").split())) == [], path.name


@pytest.mark.parametrize("page", pages(), ids=lambda page: page.stem)
def test_pages_are_in_plain_words(page):
    if page.name not in RESULTS:
        text = page.read_text("utf-8")
        assert phrases(" ".join(text.split())) == []
        headings = re.findall(r"^#+ .*|^\|.*\n(?=\|[-| ]+\|$)", text, re.M)
        assert [line for line in headings if QUESTION.search(line)] == []


def helps(command, name=""):
    """Yield the help of a command, of its options and of the commands below it."""
    yield name, command.help or ""
    yield from ((f"{name} {p.name}", getattr(p, "help", None) or "") for p in command.params)
    for word, below in getattr(command, "commands", {}).items():
        yield from helps(below, f"{name} {word}")


def first_lines():
    """Yield the public names with the first lines of their docstrings, members included."""
    offered = [(name, getattr(multicell, name)) for name in multicell.__all__ if name != "testing"]
    checks = [(n, v) for n, v in vars(testing).items() if n.startswith("check_")]
    for name, value in [*offered, *checks]:
        yield name, (inspect.getdoc(value) or "").split("\n")[0]
        for part, member in vars(value).items() if inspect.isclass(value) else ():
            plain = getattr(member, "fget", None) or getattr(member, "func", None) or member
            if not part.startswith("_") and inspect.isroutine(getattr(plain, "__func__", plain)):
                yield f"{name}.{part}", (inspect.getdoc(plain) or "").split("\n")[0]


def descriptions():
    """Yield the texts of the keys of a scene, as they are declared."""
    for path in sorted((PACKAGE / "scene").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.keyword) and node.arg == "doc":
                yield f"{path.name}:{node.value.lineno}", ast.unparse(node.value)


def test_helps_and_first_lines_ask_no_questions():
    known = [*helps(main), *first_lines(), *descriptions()]
    assert len(known) > 400
    assert [f"{name}: {text}" for name, text in known if QUESTION.search(text)] == []


def test_a_help_begins_with_a_word_for_its_thing():
    """A text that begins with 'Of' leaves the reader to find what it is of."""
    assert [f"{name}: {text}" for name, text in helps(main) if text.startswith("Of ")] == []


def test_phrases_are_seen(tmp_path):
    (tmp_path / "a.py").write_text('"""Growth goes\non."""\nx = 1  # the eye stands here\n')
    found = [phrase for _, text in texts(tmp_path / "a.py") for phrase in phrases(text)]
    assert [phrase.partition(":")[0] for phrase in found] == ["'goes on'", "'the eye stands'"]
    assert QUESTION.search("Return what cells do")
    assert QUESTION.search("## What the method does")
    (tmp_path / "b.py").write_text(
        'def f():\n    """Return it,\n    what\n  it finds."""\n# what it has\n'
    )
    assert questions(tmp_path / "b.py") == [f"{tmp_path / 'b.py'}:{line}" for line in (2, 5)]
    assert phrases("It continues; the sentence stretches on.") == []
