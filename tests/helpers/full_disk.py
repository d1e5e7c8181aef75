"""Writers of files on a disk of a given size: each ends well, or in words and with nothing open."""

import gc
import json
import os
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

from network_models import WITH_NETWORK, WRITTEN
from physicell_project import writer

import multicell as mc
from multicell.studies.axes import parse_ranges

SHORT = ["--set", "duration=2 h", "--set", "output.every=1 h"]
FEW = ["--set", "initial.count=12", "--set", "duration=10 min"]
FREE = ["--free", "growth.cycle_time=8:25 h"]
DOSES = ["--set", "death.apoptosis_rate=0", "--set", "duration=20 h", "--seeds", "1", "--yes",
         "--dose", "death.apoptosis_rate=0,0.005,0.02,0.05,0.2,0.6 1/h"]  # fmt: skip
IN_PLACE = {"study report": "study", "study run": "planned", "view": "run"}
"""Commands that write into a folder that is there, and its name."""
WRITING = {
    "run": lambda at, out: ["run", "growth", "-o", out, *SHORT],
    "resume": lambda at, out: ["resume", at / "run", "-o", out, "--set", "duration=3 h"],
    "export": lambda at, out: ["export", at / "run", "-o", out],
    "export netcdf": lambda at, out: ["export", at / "run", "-o", out, "--format", "netcdf"],
    "plot": lambda at, out: ["plot", at / "run", "-o", out.with_suffix(".png")],
    "study new": lambda at, out: ["study", "new", "growth", "-o", out],
    "study run": lambda at, out: ["study", "run", at / "planned", "--cores", "1"],
    "study report": lambda at, out: ["study", "report", at / "study"],
    "compare": lambda at, out: ["compare", "settle", "-o", out, "--methods", "euler", *FEW],
    "stability": lambda at, out: ["stability", "settle", "-o", out, "--methods", "euler", *FEW],
    "stability in motion": lambda at, out: ["stability", "--state", f"{at / 'tissue'}:0 s",
                                            "-o", out, "--methods", "euler"],
    "sensitivity": lambda at, out: ["sensitivity", "growth", *SHORT, *FREE, "--size", "4",
                                    "-o", out, "--cores", "1"],
    "fit": lambda at, out: ["fit", "growth", *SHORT, *FREE, "--data", at / "data.csv", "-o", out,
                            "--budget", "40", "--cores", "1"],
    "study with a network": lambda at, out: ["study", "new", at / "network.toml", "-o", out],
    "run with a network": lambda at, out: ["run", at / "network.toml", "-o", out],
    "view": lambda at, out: ["view", at / "run", "--no-browser"],
    "movie": lambda at, out: ["movie", at / "run", "-o", out.with_suffix(".gif")],
    "movie in space": lambda at, out: ["movie", at / "run", "-o", out.with_suffix(".webp"),
                                       "--space"],
    "profile": lambda at, out: ["profile", at / "fit", "-o", out.with_suffix(".svg")],
    "dose response": lambda at, out: ["dose-response", "growth", *DOSES, "-o", out, "--cores", "1"],
    "import": lambda at, out: ["import", "physicell", at / "config" / "settings.xml", "-o", out],
    "coarsen": lambda at, out: ["coarsen", "growth", "--set", "initial.count=100",
                                "-o", out.with_suffix(".toml")],
    **{f"export {kind}": partial(lambda kind, at, out: ["export", at / "run", "-o", out,
                                                        "--format", kind], kind)
       for kind in ("parquet", "vtk", "anndata", "openvt", "simularium", "ro-crate")},
    "init": lambda at, out: ["init", "growth", "-o", out.with_suffix(".toml")],
}  # fmt: skip
"""Commands that write, by name: of a folder with a run, a study and data, and where to write."""


def prepare(place, multicell):
    """Make the run, studies, fit, data and scenes that the commands need.

    - ``multicell``: carries out a command line, and returns its exit code and what it said
    """
    study = ["study", "new", "growth", *SHORT, "--vary=cells.young=1,2 kPa", "-o"]
    (place / "data.csv").write_text("time / h,diameter / um\n0.5,15\n1,15\n1.5,16\n2,16\n")
    for words in (
        ["run", "growth", "-o", place / "run", *SHORT, "--no-report"],
        [
            "run",
            "settle",
            "-o",
            place / "tissue",
            "--set",
            "initial.count=8",
            "--set",
            "duration=1 min",
            "--no-report",
        ],
        [*study, place / "study"],
        ["study", "run", place / "study", "--cores", 1, "--no-report"],
        [*study, place / "planned"],
        WRITING["fit"](place, place / "fit"),
    ):
        code, said = multicell(*words)
        assert code == 0, said
    (place / "own.ant").write_text(WRITTEN)
    (place / "network.toml").write_text(WITH_NETWORK)
    writer(place)()


def export(source, folder, format):
    mc.export(source, folder, format=format, overwrite=True)


def study_table(source, folder, format):
    """Write the table of a study to a disk; its runs are elsewhere."""
    from multicell.studies import table

    table.save_dataset(mc.load_study(source).to_xarray(), Path(folder) / table.TABLE_FILE)


def play(source, folder, format):
    """Run a scene as the page with sliders does, whose folder is on a disk."""
    from multicell.cli.playground import Playground

    tempfile.tempdir = folder
    scene = mc.load_scene(source)
    ranges = parse_ranges({"cells.young": "1:2 kPa"}, scene)
    with Playground(scene, ranges, 1.0, "", ()) as ground:
        ground.begin()
        while (status := ground.status())["going"]:
            time.sleep(0.1)
        if "done" not in status["text"]:
            raise mc.OutputError(status["text"])


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
