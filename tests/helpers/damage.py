"""Damage to result folders, and what must hold of whatever reads them then.

Each case is one number: :func:`hurt` does the same damage for the same number.
"""

import os
import random
import shutil
import signal
from itertools import pairwise
from pathlib import Path

import h5py
import numpy as np
from forged import stretch
from forks import limit_memory

import multicell as mc
from multicell.results.journal import Reader
from multicell.results.reader import Contents

MEMORY = 3 << 30  # bytes of address space beyond what the process has
COPIES = ("*.network.*", "*.begins.*")  # of files that a scene names
RECORD_FILES = ("frames.h5", "frames.journal")


def hurt(folder, rng):
    ways = [cut, cut, flip, flip, flip, _overwrite, _lengthen, special, text]
    if (folder / "frames.h5").is_file():
        ways += [_edit] * 10
    if (folder / "frames.journal").is_file():
        ways += [_shuffle] * 3
    way = rng.choice(ways)
    copies = sorted(path.name for way in COPIES for path in folder.glob(way))
    small = ["scene.toml", "summary.json", *copies]
    names = small if way is text else [*RECORD_FILES, *RECORD_FILES, *small]
    path = rng.choice([folder / name for name in names if (folder / name).is_file()])
    whole = way in (_edit, _shuffle)
    return f"{path.name}, {way.__name__}: {way(folder if whole else path, rng)}"


def cut(path, rng):
    size = path.stat().st_size
    left = rng.choice([0, rng.randrange(200), rng.randrange(size + 1)])
    os.truncate(path, min(left, size))
    return left


def flip(path, rng):
    data = bytearray(path.read_bytes())
    # HDF5 has its own structure at the beginning and all over the file
    reach = rng.choice([100, 2_000, len(data), len(data)])
    places = [rng.randrange(min(reach, len(data))) for _ in range(rng.choice([1, 1, 1, 2, 8, 64]))]
    for place in places:
        data[place] ^= 1 << rng.randrange(8)
    path.write_bytes(data)
    return places


def _overwrite(path, rng):
    data = bytearray(path.read_bytes())
    start = rng.randrange(len(data))
    length = min(rng.choice([4, 100, 4096, 1 << 20]), len(data) - start)
    data[start : start + length] = rng.choice(
        [bytes(length), b"\xff" * length, rng.randbytes(length)]
    )
    path.write_bytes(data)
    return f"from {start} for {length}"


def _lengthen(path, rng):
    tail = rng.choice([bytes(5000), rng.randbytes(5000), path.read_bytes()])
    path.write_bytes(path.read_bytes() + tail)


def special(path, rng):
    """Put something else in the place of a file."""
    way = rng.choice(["fifo", "zero", "folder", "dangling", "loop", "nothing", "empty", "other"])
    others = [other for other in path.parent.iterdir() if other.is_file() and other != path]
    path.unlink()
    if way == "fifo":
        os.mkfifo(path)
    elif way == "folder":
        path.mkdir()
    elif way == "empty":
        path.touch()
    elif way == "other" and others:
        shutil.copy(rng.choice(sorted(others)), path)
    elif way in ("zero", "dangling", "loop"):
        path.symlink_to({"zero": "/dev/zero", "dangling": "nowhere", "loop": path.name}[way])
    return way


def text(path, rng):
    """Edit a small file as a person or a broken program would."""
    edits = {
        "deep": "[" * 100_000, "deep table": '{"a":' * 5000 + "1" + "}" * 5000,
        "digits": f'{{"cells": {"1" * 5000}}}', "list": "[1, 2]", "number": "3", "nothing": "",
        "nan": '{"time": NaN, "cells": Infinity}', "null": "null", "keys": ".".join("a" * 30_000),
        "types": '{"digest": [], "problem": 3, "time": {}, "reason": [1]}', "latin": "\udce4",
    }  # fmt: skip
    if path.suffix == ".toml":
        text = path.read_text()
        edits |= {
            "other cells": text.replace("young = 1.0", "young = 1.5"),
            "other nutrient": text.replace("nutrients.oxygen", "nutrients.glucose"),
            "no nutrient": text.partition("[nutrients")[0],
            "deep value": f"title = {edits['deep']}\n{text}",
            "many digits": f"seed = {'1' * 5000}\n",
            "remark": "# looked at\n" + text,
        }
    name = rng.choice(list(edits))
    path.write_bytes(edits[name].encode("utf-8", "surrogateescape"))
    return name


def _shuffle(folder, rng):
    """Leave out, repeat or exchange records of the journal; each remains as it was."""
    path = folder / "frames.journal"
    data, records = path.read_bytes(), Reader(path).records
    ends = [0, *(record.begin + record.length for record in records)]
    pieces = [data[a:b] for a, b in pairwise(ends)]
    k, j = rng.randrange(len(pieces)), rng.randrange(len(pieces))
    way = rng.choice(["left out", "repeated", "exchanged"])
    if way == "left out":
        del pieces[k]
    elif way == "repeated":
        pieces.insert(j, pieces[k])
    else:
        pieces[k], pieces[j] = pieces[j], pieces[k]
    path.write_bytes(b"".join(pieces))
    return f"record {k} {way} at {j}"


def _edit(folder, rng):
    """Edit frames.h5 with h5py, which keeps all of HDF5's own checksums right."""
    path = folder / "frames.h5"
    with h5py.File(path, "r+") as file:
        sets, groups = [], []
        file.visititems(lambda n, o: (sets if isinstance(o, h5py.Dataset) else groups).append(n))
        name = rng.choice(sets)
        way = rng.choice([
            "delete", "delete group", "value", "value", "value", "shrink", "grow", "huge", "type",
            "width", "soft", "external", "storage", "virtual", "group", "attribute", "no attribute",
            "index", "state", "loop",
        ])  # fmt: skip
        if way == "delete":
            del file[name]
        elif way == "delete group":
            name = rng.choice(groups)
            del file[name]
        elif way == "value":
            _other_value(file[name], rng)
        elif way in ("shrink", "grow", "huge"):
            rows = len(file[name])
            size = {"shrink": rng.randrange(rows + 1), "grow": rows + 5, "huge": 1 << 55}[way]
            stretch(file, name, size)
        elif way == "type":
            _put(file, name, _other_type(file[name][()], rng))
        elif way == "width":
            _put(file, name, np.zeros((len(file[name]), 2, 2)))
        elif way in ("soft", "external", "loop"):
            _link(file, folder, name, way)
        elif way in ("storage", "virtual"):
            _elsewhere(file, folder, name, way)
        elif way == "group":
            del file[name]
            file.create_group(name)
        elif way == "attribute":
            key = rng.choice(list(file.attrs))
            file.attrs[key] = rng.choice([-1, 10**6, "x", np.zeros(3), np.nan])
            name = f"attribute {key}"
        elif way == "no attribute":
            key = rng.choice(list(file.attrs))
            del file.attrs[key]
            name = f"attribute {key}"
        elif way == "index":
            name = rng.choice([n for n in sets if n.endswith(("offsets", "shape"))])
            values = file[name][()]
            values[rng.randrange(len(values))] = rng.choice([-1, 0, 7, 1 << 40, -(1 << 62)])
            file[name][...] = values
        elif way == "state":
            name = rng.choice(["cells/state", "cells/phase", "cells/kind", "lineage/ends"])
            if len(values := file[name][()]):
                codes = values["cause"] if values.dtype.names else values
                codes[rng.randrange(len(codes))] = rng.choice([-5, 9, 77, 127])
                file[name][...] = values
    return f"{way} {name}"


def _other_value(column, rng):
    """Change one number by so little that only a checksum can tell."""
    if column.size:
        values = column[()]
        fields = [offset for _, offset in (values.dtype.fields or {"": (0, 0)}).values()]
        place = rng.randrange(values.size) * values.itemsize + rng.choice(fields)
        values.reshape(-1).view(np.uint8)[place] ^= 1
        column[...] = values


def _other_type(values, rng):
    """Return values of another type; of a table one column has it."""
    kind = rng.choice(["<f4", ">f8", "<i4", "S3"])
    if not values.dtype.names:
        return values.astype(kind)
    name = rng.choice(values.dtype.names)
    kinds = [
        (field, kind if field == name else values.dtype[field]) for field in values.dtype.names
    ]
    return values.astype(kinds)


def _put(file, name, values):
    del file[name]
    file.create_dataset(name, data=values)


def _link(file, folder, name, way):
    """Put a link in the place of a data set, to where its data are."""
    if way == "soft":
        file.move(name, "moved")
        file[name] = h5py.SoftLink("/moved")
    elif way == "loop":
        del file[name]
        file[name] = h5py.SoftLink(f"/{name}")
    else:
        with h5py.File(folder / "elsewhere.h5", "a") as other:
            file.copy(name, other, "data")
        del file[name]
        file[name] = h5py.ExternalLink("elsewhere.h5", "/data")


def _elsewhere(file, folder, name, way):
    """Let a data set keep its data in another file."""
    values = file[name][()]
    del file[name]
    if way == "storage":
        (folder / "raw").write_bytes(values.tobytes() or b"x")
        if values.size:
            raw = [(str(folder / "raw"), 0, values.nbytes)]
            file.create_dataset(name, values.shape, values.dtype, external=raw)
        return
    with h5py.File(folder / "elsewhere.h5", "a") as other:
        other["data"] = values
    layout = h5py.VirtualLayout(values.shape, values.dtype)
    if values.size:
        layout[...] = h5py.VirtualSource(str(folder / "elsewhere.h5"), "data", values.shape)
    file.create_virtual_dataset(name, layout)


# --- what must hold ---------------------------------------------------------------------------


def check(number, folder, whole):
    """Damage a folder and read it in all ways; return 0, or 1 with words where one is wrong."""
    folder, whole = Path(folder), Path(whole)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    rng = random.Random(number)
    print(hurt(folder, rng), flush=True)
    limit_memory(MEMORY)
    before = {path: path.lstat().st_size for path in folder.parent.iterdir() if path != folder}
    ways = [_frames_and_more, _tables]
    ways += rng.sample([_resumed_here, _resumed_from_the_first, _report], 2)
    refusals = []
    for way in ways:
        try:
            way(folder, whole)
        except mc.MulticellError as error:
            refusals.append(f"{way.__name__} refused: {error}")
    assert all(len(text) < 2000 for text in refusals)
    after = {path: path.lstat().st_size for path in folder.parent.iterdir() if path in before}
    assert before == after, "something outside the folder has changed"
    print("\n".join(refusals), flush=True)
    return 0


def _frames_and_more(folder, whole):
    """All that can be read is what was written."""
    here, there = Contents(folder), Contents(whole)
    frames = [place.digest for place in there.places]
    assert [place.digest for place in here.places] == frames[: len(here.places)]
    known = {}
    for k in range(len(here.places)):
        try:
            known[k] = here.frame(k)
        except mc.OutputError:
            continue
    for k, frame in known.items():
        _same_frame(frame, there.frame(k))
    _same_history(here.history(), there.history())
    result = mc.load_result(folder)
    assert len(result.frames) == len(here.places)
    if here.places:
        _same_columns(result.lineage, there.lineage(len(here.places) - 1).table())


def _same_frame(frame, other):
    assert (frame.time, frame.step) == (other.time, other.step)
    for name, column in frame.cells.columns():
        assert column.tobytes() == getattr(other.cells, name).tobytes(), name
    assert set(frame.fields) == set(other.fields)
    for name, field in frame.fields.items():
        assert field.values.tobytes() == other.fields[name].values.tobytes()
        assert field.origin.tobytes() == other.fields[name].origin.tobytes()
        assert field.spacing == other.fields[name].spacing
    for name, values in frame.concentrations.items():
        assert values.tobytes() == other.concentrations[name].tobytes()
    assert frame.contacts.tobytes() == other.contacts.tobytes()
    assert repr(frame.progress) == repr(other.progress)


def _same_history(history, other):
    for name, column in history.items():
        assert column.tobytes() == other[name][: len(column)].tobytes(), name


def _same_columns(one, other):
    assert set(one) == set(other)
    for name, column in one.items():
        np.testing.assert_array_equal(column, other[name], err_msg=name)


def _tables(folder, whole):
    """A table that can be exported begins as the right one does."""
    mc.export(folder, folder / "tables", overwrite=True)
    for path in (folder / "tables").iterdir():
        right = (whole / "tables" / path.name).read_bytes()
        if path.name != "lineage.csv":  # ends come to earlier lines later
            assert right.startswith(path.read_bytes()), path.name


def _resumed_here(folder, whole):
    """A run that can go on comes to the right end."""
    _same_run(mc.resume(folder, report=False, threads=1), whole)


def _resumed_from_the_first(folder, whole):
    result = mc.resume(folder, 0, output=folder / "again", report=False, threads=1)
    _same_run(result, whole)


def _report(folder, whole):
    mc.load_result(folder).report()


def _same_run(result, whole):
    there = mc.load_result(whole)
    assert len(result.frames) == len(there.frames)
    for frame, other in zip(result.frames, there.frames, strict=True):
        _same_frame(frame, other)
    _same_history(there.history, result.history)
    _same_columns(result.lineage, there.lineage)
