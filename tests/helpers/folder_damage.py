"""Damage to the folders of studies, fits and analyses, and what must hold of their readers.

Each case is one number: :func:`check` does the same damage for the same number.
"""

import json
import random
import shutil
from pathlib import Path

import h5py
import numpy as np
from damage import MEMORY, cut, flip, special, text
from forks import limit_memory

import multicell as mc
from multicell.comparison.result import WorkPrecision
from multicell.comparison.stability_limits.search import stability
from multicell.comparison.work_precision import compare
from multicell.errors import OutputError

NETWORK = "hif.network.ant"
"""The copy of a network's file that runs and studies keep."""
BEGINNING = "oxygen.begins.npy"
"""The copy of the file that a field begins as."""


def files_of(folder):
    """Return the files of a folder that are read again, by their paths in it."""
    own = ("study.toml", "scene.toml", "expected.json", "fit.json", "search.log", "result.json",
           "data.csv", "measured.log", "workprecision.json", "frames.h5",
           "summary.json", NETWORK, BEGINNING)  # fmt: skip
    names = [name for name in own if (folder / name).is_file()]
    runs = sorted((folder / "runs").glob("*/*")) if (folder / "runs").is_dir() else []
    wanted = ("summary.json", "frames.h5", "scene.toml", NETWORK, BEGINNING)
    return names * 2 + [str(p.relative_to(folder)) for p in runs if p.name in wanted]


def hurt(folder, rng):
    path = folder / rng.choice(files_of(folder))
    ways = [cut, flip, flip, _edit, _edit, _edit, special, special, text]
    if path.parent.parent.name == "runs" and path.name not in (NETWORK, BEGINNING):
        ways += [_of_another_run] * 3
    way = rng.choice(ways)
    return f"{path.relative_to(folder)}, {way.__name__}: {way(path, rng)}"


def _edit(path, rng):
    """Change a number as a person would, or a value with the library of the format."""
    if path.suffix in (".nc", ".h5"):
        with h5py.File(path, "r+") as file:
            sets = []
            file.visititems(lambda n, o: sets.append(n) if isinstance(o, h5py.Dataset) else None)
            name = rng.choice(sets)
            way = rng.choice(["value", "value", "delete", "external", "soft", "huge"])
            if way == "value" and file[name].dtype.kind in "fiu" and file[name].size:
                values = file[name][()]
                flat = np.atleast_1d(values).reshape(-1)
                place = rng.randrange(len(flat))
                flat[place] = flat[place] * 10 + 1
                file[name][...] = flat.reshape(np.shape(values))
            elif way == "huge":
                file.create_dataset("other", (1 << 40,), "u1", chunks=(1 << 20,))
            elif way != "value":
                del file[name]
                if way == "external":
                    file[name] = h5py.ExternalLink("/dev/zero", "/data")
                elif way == "soft":
                    file[name] = h5py.SoftLink(f"/{name}")
            return f"{way} {name}"
    data = path.read_bytes()
    digits = [k for k, byte in enumerate(data) if chr(byte) in "123456789"]
    if not digits:
        return "nothing"
    place = rng.choice(digits)
    with path.open("r+b") as file:
        file.seek(place)
        file.write(
            rng.choice(b"123456789".replace(data[place : place + 1], b"")).to_bytes(1, "big")
        )
    return f"digit at {place}"


def _of_another_run(path, rng):
    """Put the file of another run in the place of this one's."""
    others = sorted(p for p in path.parent.parent.glob(f"*/{path.name}") if p != path)
    other = rng.choice(others)
    shutil.copy(other, path)
    return other.parent.name


# --- what must hold ---------------------------------------------------------------------------


def study(place):
    made = mc.load_study(place)
    made.expected(2)
    assert len(made.status()) == len(made.plan.names)
    table = made.to_xarray()
    states = table["state"].values.ravel().tolist()  # some damage shows where a run is read
    # where no run is done there is nothing to tabulate
    diameter = table["diameter"].values if "diameter" in table else np.full(len(states), np.nan)
    return {
        "states": states,
        "diameter": np.asarray(diameter).reshape(len(states), -1).tolist(),
        "points": [dict(point.coordinates) for point in made.plan.points],
    }


def fit(place):
    given = json.loads((place.parent / "fit.arguments").read_text())
    found = mc.fit(given["scene"], place.parent / "data.csv", given["free"], output=place,
                   seeds=1, budget=30, cores=1)  # fmt: skip
    return {"best": dict(found.best.values), "chi": found.best.chi_squared}


def opened(place):
    found = mc.load_fit(place)
    return {"best": dict(found.best.values), "chi": found.best.chi_squared}


def sensitivity(place):
    given = json.loads((place.parent / "sensitivity.arguments").read_text())
    found = mc.sensitivity(given["scene"], given["free"], size=4, observables=["diameter"],
                           output=place, cores=1, report=False)  # fmt: skip
    return {"table": [row["mu_star"] for row in found.table], "notes": list(found.notes)}


def networked(place):
    """Read a study whose cells have a network."""
    found, made = study(place), mc.load_study(place)
    found["inside"] = [
        _bytes_of(mc.load_result(place / "runs" / run.name).frames[-1]) if state == "done" else []
        for run, state in zip(made.runs, found["states"], strict=True)
    ]
    return found


def network(place):
    """Read a run whose cells have a network, and run its second half once more."""
    given = mc.load_result(place)
    again = mc.resume(place, 1, output=place.parent / "again", report=False, threads=1)
    return {"frames": [_bytes_of(frame) for frame in given.frames],
            "again": [_bytes_of(frame) for frame in again.frames]}  # fmt: skip


def _bytes_of(frame):
    return [frame.time, *(column.tobytes().hex() for _, column in frame.cells.columns())]


def doses(place):
    given = json.loads((place.parent / "doses.arguments").read_text())
    found = mc.dose_response(given["scene"], given["dose"], given["doses"], seeds=1, output=place,
                             cores=1, report=False)  # fmt: skip
    return {"table": [row["viability"] for row in found.table], "notes": list(found.notes),
            "ic50": [found.ic50.value, found.ic50.low, found.ic50.high]}  # fmt: skip


def comparison(place):
    """Continue a comparison of which everything was measured and no page was made."""
    given = json.loads((place.parent / "comparison.arguments").read_text())
    kept = None
    if (place / "workprecision.json").exists():
        try:
            kept = _errors_of(WorkPrecision.read(place / "workprecision.json"))
        except OutputError as error:
            print(f"the numbers are refused: {error}", flush=True)
    found = _errors_of(compare(output=place, ladder={"step": [30.0, 15.0]}, repeats=1,
                               threads=1, **given))  # fmt: skip
    assert kept in (None, found)
    return found


def _errors_of(found):
    names = [name for name in found.table[0] if name.startswith("error")]
    return {"table": [[row["method"], *(row[name] for name in names)] for row in found.table]}


def limits(place):
    """Continue a search for limits of stability of which everything was found."""
    given = json.loads((place.parent / "limits.arguments").read_text())
    found = stability(output=place, threads=1, **given)
    return {"table": [[row["method"], row["setting"]] for row in found.table]}


def read(folder):
    """Read a folder that is named after its kind, in all ways."""
    globals()[Path(folder).name](Path(folder))


def same(found, whole):
    """Return whether what was found is right, apart from runs that are said to be damaged."""
    if "states" in found and found["points"] == whole["points"]:
        for state, row, other in zip(
            found["states"], found["diameter"], whole["diameter"], strict=True
        ):
            if state == "done" and repr(row) != repr(other):
                return False
        pairs = zip(found.get("inside", ()), whole.get("inside", ()), strict=True)
        return all(row in ([], other) for row, other in pairs)
    failed = any("failed" in note for note in found.get("notes", ()))
    return repr(found) == repr(whole) or failed


def check(number, kind, folder, whole):
    """Damage a folder and read it; return 0, or 1 with words where something is wrong."""
    folder = Path(folder)
    said = hurt(folder, random.Random(number))
    print(said, flush=True)
    limit_memory(MEMORY)
    edits_plan = said.startswith(("study.toml", "scene.toml")) and ", cut:" not in said
    edits_plan = edits_plan and kind in ("study", "networked", "sensitivity")
    try:
        found = globals()[kind](folder)
    except mc.MulticellError as error:
        print(f"refused: {error}", flush=True)
        return int(len(str(error)) > 3000)
    shutil.rmtree(folder)
    if edits_plan:  # the plan is the user's to edit: another plan has other results
        return 0
    assert same(json.loads(json.dumps(found)), whole), f"{said}: {found} is not {whole}"[:800]
    return 0
