"""Writers of files on a disk of a given size: each ends well, or in words and with nothing open."""

import gc
import json
import os
import sys
from pathlib import Path

import multicell as mc

SHORT = ["--set", "duration=2 h", "--set", "output.every=1 h"]
FREE = ["--free", "growth.cycle_time=8:25 h"]
WRITING = {
    "run": lambda at, out: ["run", "growth", "-o", out, *SHORT],
    "resume": lambda at, out: ["resume", at / "run", "-o", out, "--set", "duration=3 h"],
    "export": lambda at, out: ["export", at / "run", "-o", out],
    "export netcdf": lambda at, out: ["export", at / "run", "-o", out, "--format", "netcdf"],
    "plot": lambda at, out: ["plot", at / "run", "-o", out.with_suffix(".png")],
    "study new": lambda at, out: ["study", "new", "growth", "-o", out],
    "study report": lambda at, out: ["study", "report", at / "study"],
    "compare": lambda at, out: ["compare", "settle", "-o", out, "--methods", "euler"],
    "stability": lambda at, out: ["stability", "settle", "-o", out, "--methods", "euler"],
    "sensitivity": lambda at, out: ["sensitivity", "growth", *SHORT, *FREE, "--size", "4",
                                    "-o", out, "--cores", "1"],
    "fit": lambda at, out: ["fit", "growth", *SHORT, *FREE, "--data", at / "data.csv", "-o", out,
                            "--budget", "40", "--cores", "1"],
    "init": lambda at, out: ["init", "growth", "-o", out.with_suffix(".toml")],
}  # fmt: skip
"""Commands that write, by name: of a folder with a run, a study and data, and where to write."""


def export(source, folder, format):
    mc.export(source, folder, format=format, overwrite=True)


def study_table(source, folder, format):
    """Write the table of a study to a disk; its runs are elsewhere."""
    from multicell.studies import table

    table.save_dataset(mc.load_study(source).to_xarray(), Path(folder) / table.TABLE_FILE)


def attempt(way, source, folder, format=""):
    """Try to write three times in one process, as a notebook does, and print what became of it."""
    said = []
    before = _open_files()
    for _ in range(3):
        try:
            globals()[way](source, folder, format)
            said.append("")
        except mc.MulticellError as error:
            said.append(str(error))
    gc.collect()
    print(json.dumps({"said": said, "left": sorted(_open_files() - before)}), flush=True)
    return 0


def _open_files():
    found = set()
    for number in os.listdir("/proc/self/fd") if sys.platform == "linux" else ():
        try:
            found.add(os.readlink(f"/proc/self/fd/{number}"))
        except OSError:
            continue
    return {name for name in found if name.endswith((".nc", ".h5ad", ".h5", ".part"))}
