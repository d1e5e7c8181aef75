"""Links lead to files and headings that are there, also from files that Sphinx does not read."""

import re

import pytest
from page_commands import ROOT, pages

FILES = [ROOT / name for name in ("README.md", "CHANGELOG.md", "CONTRIBUTING.md")]
LINK = re.compile(r"!?\[[^\]]*\]\(<?([^)\s>]+)>?\)")

FIGURE = re.compile(r"^( *)(`{3,}|:{3,})\{(?:image|figure)\}.*?^\1\2", re.DOTALL | re.MULTILINE)


GALLERY = ROOT / "docs" / "gallery"


def stands(path):
    """Whether a file is there, or a page of the gallery that Sphinx makes of an example."""
    if path.parent == GALLERY:
        return path.stem == "index" or (ROOT / "examples" / f"{path.stem}.py").exists()
    return path.exists()


def text_of(path):
    return re.sub(r"^( *)(`{3,}).*?^\1\2`*$", "", path.read_text("utf-8"), flags=re.S | re.M)


def slugs(path):
    """Return the names that headings of a page have in links."""
    headings = re.findall(r"^#+ +(.+?) *$", text_of(path), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in headings}


@pytest.mark.parametrize(
    "page", sorted({*FILES, *pages()}), ids=lambda page: page.relative_to(ROOT).as_posix()
)
def test_links_lead_somewhere(page):
    for target in LINK.findall(text_of(page)):
        if re.match(r"[a-z]+:", target):
            continue
        place, _, heading = target.partition("#")
        path = page.parent / place if place else page
        assert stands(path), target
        if heading:
            assert heading in slugs(path), target


def test_pictures_have_a_text_for_those_who_do_not_see_them():
    for page in pages():
        text = text_of(page)
        assert re.findall(r"!\[\s*\]\([^)]*\)", text) == [], page.name
        source = page.read_text("utf-8")
        for figure in FIGURE.finditer(source):
            assert ":alt:" in figure[0], f"{page.name}: {figure[0][:60]}"


def test_the_picture_of_the_rooms_knows_each_room(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "docs" / "programs")
    import rooms

    assert sorted(rooms.WHAT) == sorted(room for floor in rooms.floors() for room in floor)
