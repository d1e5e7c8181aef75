"""Measurements of performance.py: the table, its medians, and numbers quoted on pages.

A page quotes a figure by a mark behind it, which no reader sees: ``14.4 s<!-- figure: hour,
1000000 cells, 1 thread -->``. The names are the keys of :func:`figures`. :func:`requote` writes the
value of the table with as many digits as stand there (zeros at the end of a whole number are none),
so that a page is right if that changes nothing. Blocks between two marks (marked.py) are made
as a whole.
"""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import pandas as pd
from marked import replaced

DOCS = Path(__file__).parents[1]
TABLE = DOCS / "chart-data" / "speed.csv"
"""One row for each measurement of each round; of what has been measured again only the last."""
ORIGINS = DOCS / "figures" / "origins.json"
PAGE = DOCS / "performance.md"
KEY = ["what", "program", "cells", "threads"]
PARTS = ["mechanics", "nutrient", "events", "biology"]
SERIAL = "serial"  # part of the CPU time of an hour that one of the threads has spent alone
RUNS = {
    "spheroid": "built-in `spheroid`, 12 days, one thread, kernels compiled before",
    "first step": "any run with compiled kernels, from the command to the end of its first step",
    "first run": "the first `multicell run spheroid -o out` after installing: compilation, 12 d, "
    "pictures and page",
}
"""Name -> the single commands that are timed."""


def read() -> pd.DataFrame:
    """Return the table."""
    texts = dict.fromkeys(["what", "program", "machine", "date", "note"], str)
    return pd.read_csv(TABLE, dtype=texts, keep_default_na=False, na_values={"others": [""]} | {
        name: [""] for name in ("us_per_cell", "kB_per_cell", "simulated_min", *PARTS, SERIAL)
    })  # fmt: skip


def write(new: pd.DataFrame) -> None:
    """Put measurements into the table, in place of earlier ones of the same things."""
    old = read()
    again = old[KEY].apply(tuple, axis=1).isin(set(new[KEY].itertuples(index=False, name=None)))
    whole = pd.concat([old[~again], new[old.columns]]).sort_values([*KEY, "round"])
    whole.to_csv(TABLE, index=False, float_format="%.6g", lineterminator="\n")


def medians(rows: pd.DataFrame) -> pd.DataFrame:
    """Return the median of every column of numbers over the rounds, with the ends of the times."""
    groups = rows.groupby(KEY)
    found = groups[["seconds", "us_per_cell", "kB_per_cell", *PARTS, SERIAL]].median()
    ends = groups["seconds"].agg(least="min", most="max", rounds="count")
    return found.join(ends).reset_index()


def ratios(rows: pd.DataFrame) -> pd.DataFrame:
    """Return how many times as long other programs take in each round, by ``program`` and cells."""
    beside = rows[rows["what"] == "beside"]
    ours = beside["program"] == "multicell"
    both = beside[~ours].merge(
        beside[ours], on=["cells", "threads", "round"], suffixes=("", "_ours")
    )
    return both.assign(ratio=both["seconds"] / both["seconds_ours"])


def figures() -> dict[str, float]:
    """Return name -> value of all figures that pages may quote."""
    rows = read()
    found: dict[str, float] = {}
    middle = medians(rows)
    for row in middle.itertuples():
        if row.what == "hour":
            threads = f"{row.threads} thread{'s' * (row.threads > 1)}"
            found[f"hour, {row.cells} cells, {threads}"] = row.seconds
            found[f"part of fields in %, {row.cells} cells, {threads}"] = 100.0 * row.nutrient
            if row.threads == 1:
                found[f"memory in GB, {row.cells} cells"] = row.kB_per_cell * row.cells / 1e6
        elif row.what == "beside":
            name = row.program.split()[0]  # without its version
            found[f"{name} beside the other, {row.cells} cells"] = row.seconds
        else:
            found[f"{row.what}, s"] = row.seconds
            found[f"{row.what}, min"] = row.seconds / 60.0
    for (program, cells), both in ratios(rows).groupby(["program", "cells"]):
        found[f"times {program.split()[0]}, {cells} cells"] = both["ratio"].median()
    hours = middle[middle["what"] == "hour"].pivot(index="cells", columns="threads")["seconds"]
    for cells, times in hours.dropna().iterrows():
        found[f"gain of {max(hours.columns)} threads, {cells} cells"] = (
            times[1] / times[max(hours.columns)]
        )
    for picture, entry in json.loads(ORIGINS.read_text(encoding="utf-8")).items():
        for name, value in entry.get("facts", {}).items():
            found[f"{picture}, {name}"] = value
    return found


QUOTE = re.compile(
    r"(?P<number>\d[\d,]*(?:\.\d+)?)(?P<unit>[^\d<\n]{0,12})<!-- figure: (?P<name>[^>]+?) -->"
)
"""A number, a unit and the mark."""


def round_like(value: float, like: str) -> str:
    """Return a number with as many significant digits as another one that is printed."""
    digits = like.replace(",", "").lstrip("0.")
    count = max(1, len(digits.replace(".", "") if "." in like else digits.rstrip("0")))
    if value == 0.0:
        return "0"
    rounded = float(f"{value:.{count - 1}e}")
    return f"{rounded:,.{max(0, count - 1 - math.floor(math.log10(abs(rounded))))}f}"


def requote(text: str, known: dict[str, float]) -> str:
    """Return a page with its marked figures as the tables have them.

    Raises
    ------
    KeyError
        If a mark names nothing that is known.
    ValueError
        If no number stands before a mark.
    """

    def one(found: re.Match[str]) -> str:
        number = round_like(known[found["name"]], found["number"])
        return f"{number}{found['unit']}<!-- figure: {found['name']} -->"

    if text.count("<!-- figure: ") != len(QUOTE.findall(text)):
        raise ValueError("a mark of a figure has no number before it")
    return QUOTE.sub(one, text)


def pages() -> list[Path]:
    """Return all pages that may quote figures."""
    top = DOCS.parent
    return [top / "README.md", top / "CONTRIBUTING.md", *sorted(DOCS.rglob("*.md"))]


def table(rows: list[list[str]]) -> str:
    """Return a Markdown table; the first row is its head."""
    lines = [f"| {' | '.join(row)} |" for row in rows]
    return "\n".join([lines[0], "| " + " | ".join(["---"] * len(rows[0])) + " |", *lines[1:]])


def spread(row: Any, digits: str = ".3g") -> str:
    """Return the shortest and the longest time of the rounds."""
    return "one run" if row.rounds == 1 else f"{row.least:{digits}} to {row.most:{digits}}"


def origin(rows: pd.DataFrame) -> str:
    """Return sentences on where, when and how rows were measured."""
    said = []
    groups = rows.groupby(["machine", "date", "note"], sort=False)
    for (machine, date, note), some in groups:
        rounds = some.groupby(KEY).size()
        if rounds.max() == 1:
            how = "One run each"
        else:
            least, most = rounds.min(), rounds.max()
            count = f"{most}" if least == most else f"{least} to {most}"
            how = f"Medians of {count} rounds in turns, with the shortest and the longest,"
        others = some["others"].max()
        # of old rows it is not known
        busy = "" if pd.isna(others) else f"; other programs used up to {100 * others:.0f} % of it"
        of = f"{_which(some, rows)}: " if len(groups) > 1 else ""
        said.append(f"{of}{how} on {machine}, {date}{busy}{f'; {note}' if note else ''}.")
    return "\n\n".join(said)


def _which(some: pd.DataFrame, rows: pd.DataFrame) -> str:
    """Return the entries that distinguish some rows from the others."""
    if rows["what"].nunique() > 1:
        return ", ".join(f"*{name}*" for name in some["what"].unique())
    return ", ".join(f"{cells:,}" for cells in sorted(some["cells"].unique())) + " cells"


def costs(rows: pd.DataFrame) -> str:
    """Return the table of costs: a row for each size and number of threads."""
    chosen = rows[rows["what"] == "hour"]
    head = ["cells", "threads", "wall time an hour", "shortest to longest", "a cell", "kB a cell"]
    lines = [[*head, *PARTS]]
    for row in medians(chosen).itertuples():
        lines.append(
            [
                f"{row.cells:,}", f"{row.threads}", f"{row.seconds:.3g} s", spread(row),
                f"{row.us_per_cell:.3g} µs",
                # of fewer it is the libraries'
                f"{row.kB_per_cell:.2g}" if row.cells >= 10_000 else "",
                *(f"{100.0 * getattr(row, name):.0f} %" for name in PARTS),
            ]
        )  # fmt: skip
    return f"{origin(chosen)}\n\n{table(lines)}"


def serial_part(one: float, many: float, threads: int) -> float:
    """Return the part of the time that threads do not share (Amdahl), from two wall times."""
    return (many / one - 1.0 / threads) / (1.0 - 1.0 / threads)


def scaling(rows: pd.DataFrame) -> str:
    """Return the table of speed-ups: measured with all threads, and by Amdahl's law with more."""
    middle = medians(rows[rows["what"] == "hour"])
    table_of = middle.pivot(index="cells", columns="threads")
    times, alone = table_of["seconds"], table_of[SERIAL]
    most = max(times.columns)
    lines = [["cells", f"{most} threads, measured", "serial part", "8", "16", "64", "limit"]]
    for cells, row in times.dropna().iterrows():
        # threads share nothing below 14,337 cells
        if most == 1 or cells < 20_000:
            continue
        serial = alone.loc[cells, most]
        if pd.isna(serial):  # of old rows it is not known
            serial = serial_part(row[1], row[most], most)
        ahead = [1.0 / (serial + (1.0 - serial) / cores) for cores in (8, 16, 64)]
        limit = 1.0 / serial if serial > 0.0 else float("inf")
        lines.append(
            [f"{cells:,}", f"{row[1] / row[most]:.2f}", f"{100.0 * serial:.0f} %"]
            + [f"{value:.1f}" for value in (*ahead, limit)]
        )
    return table(lines)


def comparison(rows: pd.DataFrame) -> str:
    """Return the table of other programs, with the medians of the ratios of the rounds."""
    chosen = rows[rows["what"] == "beside"]
    middle = medians(chosen).set_index(["cells", "program"])
    lines = [["cells", "program", "a simulated hour there", "in multicell", "ratio"]]
    for (cells, program), found in ratios(chosen).groupby(["cells", "program"]):
        texts = []
        for name in (program, "multicell"):
            row = middle.loc[cells, name]
            ends = "" if row.rounds == 1 else f" ({spread(row)})"
            texts.append(f"{row.seconds:.3g} s{ends}")
        part = found["ratio"]
        ends = "" if len(part) == 1 else f" ({part.min():,.0f} to {part.max():,.0f})"
        lines.append([f"{cells:,}", program, *texts, f"{part.median():,.0f}{ends}"])
    window = chosen.loc[chosen["program"] != "multicell", "simulated_min"]
    scaled = f"An hour of the other programs is scaled from {window.min():g} simulated minutes."
    return f"{origin(chosen)} {scaled}\n\n{table(lines)}"


def runs(rows: pd.DataFrame) -> str:
    """Return the table of single commands."""
    chosen = rows[rows["what"].isin(RUNS)]
    middle = medians(chosen).set_index("what")
    lines = [["command", "time", "shortest to longest"]]
    for name, words in RUNS.items():
        if name in middle.index:
            row = middle.loc[name]
            lines.append([f"*{name}*: {words}", f"{row.seconds:.3g} s", spread(row)])
    return f"{origin(chosen)}\n\n{table(lines)}"


BLOCKS = {"costs": costs, "scaling": scaling, "PhysiCell": comparison, "single commands": runs}


def renew() -> None:
    """Write the blocks of the page, and the figures of all pages, from the table."""
    rows, text = read(), PAGE.read_text(encoding="utf-8")
    for name, block in BLOCKS.items():
        text = replaced(text, name, block(rows))
    PAGE.write_text(text, encoding="utf-8")
    known = figures()
    for page in pages():
        if "<!-- figure: " in (text := page.read_text(encoding="utf-8")):
            page.write_text(requote(text, known), encoding="utf-8")
