"""Badges of the README, and the places that need the address of the repository.

``python docs/packaging/publish.py`` writes the badges of the README to ``docs/static/badges/`` from
``pyproject.toml``: files of the repository, which need no server. The owner adds
``--address https://HOST/OWNER/multicell`` once the package has one: it is written to
``[project.urls]``, ``CITATION.cff`` and the list of links of new issues.
"""

from __future__ import annotations

import argparse
import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]
URLS = """[project.urls]
Repository = "{0}"
Documentation = "{0}/tree/main/docs"
Changelog = "{0}/blob/main/CHANGELOG.md"
Issues = "{0}/issues"

"""
LINKS = """contact_links:
  - name: A vulnerability
    url: {0}/security
    about: Report it in private.
"""
_LETTER = 6.6  # px of a letter of 11 px, on average
_BADGE = """<svg xmlns="http://www.w3.org/2000/svg" width="{wide:.0f}" height="20" role="img" \
aria-label="{name}: {value}">
<rect width="{wide:.0f}" height="20" rx="3" fill="#22303c"/>
<path d="M{left:.0f} 0h{right:.0f}a3 3 0 0 1 3 3v14a3 3 0 0 1-3 3h-{right:.0f}z" fill="#1f7f54"/>
<g fill="#fff" font-family="Verdana,DejaVu Sans,sans-serif" font-size="11">
<text x="7" y="14" textLength="{first:.0f}">{name}</text>
<text x="{start:.0f}" y="14" textLength="{second:.0f}">{value}</text>
</g></svg>
"""


def project(root: Path = ROOT) -> dict[str, object]:
    """Return the table ``[project]``."""
    return dict(tomllib.loads((root / "pyproject.toml").read_text("utf-8"))["project"])


def facts(known: dict[str, object]) -> dict[str, str]:
    """Return the texts of the badges, by name."""
    pythons = re.findall(r"Python :: (3\.\d+)'", str(known["classifiers"]))
    return {
        "version": str(known["version"]),
        "python": f"{pythons[0]} to {pythons[-1]}",
        "license": str(known["license"]),
    }


def badge(name: str, value: str) -> str:
    """Return a badge as SVG."""
    first, second = _LETTER * len(name), _LETTER * len(value)
    left = first + 14.0
    sizes = {"first": first, "second": second, "left": left, "start": left + 7.0}
    return _BADGE.format(
        name=name, value=value, wide=left + second + 14.0, right=second + 11.0, **sizes
    )


def write_badges(root: Path = ROOT) -> list[Path]:
    """Write all badges and return their files."""
    folder = root / "docs" / "static" / "badges"
    folder.mkdir(parents=True, exist_ok=True)
    found = []
    for name, value in facts(project(root)).items():
        path = folder / f"{name}.svg"
        path.write_text(badge(name, value), "utf-8")
        found.append(path)
    return found


def write_address(address: str, root: Path = ROOT) -> None:
    """Write the address of the repository wherever one is needed; again with another one.

    Raises ValueError for what is no address of a repository.
    """
    if not re.fullmatch(r"https://[\w.-]+/[\w.-]+/[\w.-]+", address):
        raise ValueError(f"{address!r} is no address: https://HOST/OWNER/NAME")
    rewrite(
        root / "pyproject.toml",
        r"\[project\.urls\]\n(?:.+\n)+\n",
        URLS,
        address,
        "[project.scripts]",
    )
    rewrite(
        root / "CITATION.cff",
        r"repository-code: .+\n",
        "repository-code: {0}\n",
        address,
        "keywords:",
    )
    rewrite(
        root / ".github/ISSUE_TEMPLATE/config.yml",
        r"contact_links:\n(?: .+\n)+",
        LINKS,
        address,
        "",
    )


def rewrite(path: Path, old: str, new: str, address: str, before: str) -> None:
    """Put a text with the address in place of an old one: before a line, or at the end."""
    text = re.sub(old, "", path.read_text("utf-8"))
    place = text.index(f"\n{before}") + 1 if before else len(text)
    path.write_text(text[:place] + new.format(address) + text[place:], "utf-8")


def main() -> None:
    """Write the badges, and the address if one is given."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--address", help="of the repository")
    address = options.parse_args().address
    for path in write_badges():
        print(path.relative_to(ROOT))
    if address is not None:
        write_address(address)


if __name__ == "__main__":
    main()
