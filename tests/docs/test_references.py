"""References have one home; what the citation file names is there too, with the same DOI."""

import re

import yaml
from page_commands import ROOT, pages

BIBLIOGRAPHY = (ROOT / "docs" / "references.bib").read_text("utf-8")
DOI = re.compile(r"10\.\d{4,9}/[^\s\"}]+")


def entries():
    found = re.findall(r"^@\w+\{(\w+),\n(.*?)^\}", BIBLIOGRAPHY, re.DOTALL | re.MULTILINE)
    assert len(found) == BIBLIOGRAPHY.count("\n@") + 1
    return dict(found)


def test_no_reference_stands_twice():
    keys = re.findall(r"^@\w+\{(\w+),", BIBLIOGRAPHY, re.MULTILINE)
    assert len(keys) == len(set(keys))
    dois = [doi.lower() for doi in DOI.findall(BIBLIOGRAPHY)]
    assert len(dois) == len(set(dois))


def test_every_reference_is_cited_on_a_page_and_every_citation_has_one():
    cited = set()
    for page in pages():
        for keys in re.findall(r"\{cite:[tp]\}`([\w, ]+)`", page.read_text("utf-8")):
            cited.update(key.strip() for key in keys.split(","))
    assert sorted(set(entries()) ^ cited) == []


def test_papers_of_the_citation_file_are_among_the_references():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))
    years = {
        doi.lower(): int(re.search(r"year = \{(\d{4})\}", text)[1])
        for text in entries().values()
        for doi in DOI.findall(text)
    }
    given = {ref["doi"].lower(): ref["year"] for ref in citation["references"] if "doi" in ref}
    assert len(given) >= 8
    assert {doi: years.get(doi) for doi in given} == given
    titles = re.sub(r"[{}\\\"]", "", BIBLIOGRAPHY).lower()
    for reference in citation["references"]:
        if "doi" not in reference:
            assert reference["title"].lower() in titles


def test_the_paper_cites_what_the_bibliography_has():
    paper = (ROOT / "docs" / "paper" / "paper.md").read_text("utf-8")
    cited = set(re.findall(r"@(\w+)", paper))
    assert len(cited) > 10
    assert cited <= set(entries())
