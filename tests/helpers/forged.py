"""Journals and result files that are forged: every checksum is right, and what they say is not."""

import copy
import json
import math
import random
import zlib
from pathlib import Path

import h5py
import numpy as np
from forks import limit_memory

import multicell as mc
from multicell.results.journal import PREFIX, Reader, array_digest

MEMORY = 1 << 30  # bytes of address space beyond what the process has
VALUES = (
    None, True, -1, 3.5, 1 << 70, -(1 << 62), 10**6, "x", "", [], {}, [[]], ["a", "a"], [1], [None],
    {"a": 1}, math.nan, math.inf, "\ud800", "9" * 5000,
)  # fmt: skip
TYPES = (
    "O", "|O", "<f16", "|S9", "<U3", "|V8", "<M8[s]", "<m8[s]", "<c8", ">f8", "<f4", "<i8", "<u8",
    "|b1", "|i1", "<f2", "f8", "", "x", 5, None, ["<f8"], [["a", "<f8"]], "|S1000000000", "<f8,<i4",
    "1000000<f8",
)  # fmt: skip
TEXTS = (
    b"", b"[]", b"3", b"null", b"\xff\xfe", b"[" * 100_000, b'{"kind":' * 900, b"{}",
    b'{"kind": "open"}', b'{"kind": "frame"}', b'{"kind": []}', b'{"kind": "other"}', b"NaN",
    b'{"kind": "back", "scene": "", "frames": ' + b"9" * 5000 + b', "rows": 0}',
)  # fmt: skip


def rewrite(path, number, edit):
    """Write a journal anew with one record edited, and all checksums right.

    - ``edit``: of header and body; returns both, the header also as bytes
    """
    data, chain, out = path.read_bytes(), 0, []
    for k, record in enumerate(Reader(path).records):
        header, body = record.header, data[record.begin : record.begin + record.length]
        text = json.dumps(header).encode()
        if k == number:
            header, body = edit(copy.deepcopy(header), body)
            text = header if isinstance(header, bytes) else json.dumps(header).encode()
        head = PREFIX.pack(b"mcj3", len(text), len(body), zlib.crc32(text), _check(header, body), 0)
        chain = zlib.crc32(head[:-4], chain)
        out += [head[:-4], chain.to_bytes(4, "little"), text, body]
    path.write_bytes(b"".join(out))


def _check(header, body):
    """Return the checksum that arrays have of which a header says what they are."""
    arrays = header.get("arrays", []) if isinstance(header, dict) else []
    return zlib.crc32(body, zlib.crc32(json.dumps(arrays).encode()))


def edit_of(rng, *, numbers=False):
    """Return a drawn edit, and what it is in words.

    - ``numbers``: whether also of whole numbers in arrays, which may mean something
    """

    def entry(header, body):
        key, value = rng.choice([k for k in header if k != "arrays"]), rng.choice(VALUES)
        words.append(f"{key} = {value!r}"[:80])
        return {**header, key: value}, body

    def lacking(header, body):
        key = rng.choice(list(header))
        words.append(f"no {key}")
        return {k: v for k, v in header.items() if k != key}, body

    def text(header, body):
        words.append("another text")
        return rng.choice(TEXTS), body

    def arrays(header, body):
        there = header.get("arrays") or [["x", "<f8", [1]]]
        header["arrays"] = there
        k, shape = rng.randrange(len(there)), list(there[-1][2])
        way = rng.choice(["name", "type", "shape", "shape", "whole", "swap", "alike", "drop"])
        words.append(f"array {k} {way}")
        if way == "name":
            there[k][0] = rng.choice([*VALUES, there[0][0], "cells/id", "fields/oxygen/values"])
        elif way == "type":
            there[k][1] = rng.choice(TYPES)
        elif way == "shape":
            there[k][2] = rng.choice([
                *VALUES, [-1], [1 << 40], [1 << 62, 4], [0, 1 << 62], [0, 1 << 40, 1 << 40], [1.5],
                ["3"], [True], [[1]], [1] * 40, [len(body)], [2, *shape], [-1, -8],
            ])  # fmt: skip
        elif way == "whole":
            header["arrays"] = rng.choice([*VALUES, {"a": ["x", "<f8", [1]]}, [["x", "<f8"]]])
        elif way == "swap":
            j = rng.randrange(len(there))
            there[k], there[j] = there[j], there[k]
        elif way == "drop":
            del there[k]
        else:  # as many bytes of another type and shape
            size = int(there[k][1][2:]) * math.prod(there[k][2])
            kind = rng.choice(["<f8", "<i8", "|i1", "|b1", "<f4", "<u8", "<i2"])
            there[k] = [there[k][0], kind, rng.choice([[size // int(kind[2:])], [1, size]])]
        return header, body

    def number(header, body):
        """Exchange a whole number of an array, such as a type, for one that is out of its range."""
        there, begin = header.get("arrays", []), 0
        places = []
        for name, kind, shape in there:
            size = int(kind[2:]) * math.prod(shape)
            if kind[1] == "i" and size:
                places.append((name, kind, begin, size))
            begin += size
        if places:
            name, kind, begin, size = rng.choice(places)
            values = np.frombuffer(body[begin : begin + size], kind).copy()
            top = np.iinfo(kind).max
            place = rng.randrange(len(values))
            values[place] = rng.choice([-1, -2, 5, 77, top, -top - 1, top // 2])
            words.append(f"{name}[{place}] = {values[place]}")
            body = body[:begin] + values.tobytes() + body[begin + size :]
        return header, body

    def longer(header, body):
        words.append("another body")
        return header, rng.choice([b"", body + b"x", body[:-1], bytes(len(body)), body * 2])

    words = []
    ways = [entry, entry, lacking, text, arrays, arrays, arrays, longer]
    way = rng.choice([*ways, number, number, number] if numbers else ways)
    return way, words


def forge(folder, rng):
    """Forge the journal of a folder, or the sizes in its file; return what was done in words."""
    path, beside = folder / "frames.journal", folder / "frames.h5"
    if path.is_file() and (not beside.is_file() or rng.random() < 0.8):
        number = rng.randrange(len(Reader(path).records))
        edit, words = edit_of(rng, numbers=True)
        rewrite(path, number, edit)
        return f"record {number}: {' '.join(words)}"
    with h5py.File(beside, "r+") as file:
        return resize(file, rng)


def stretch(file, name, rows):
    """Let a data set say that it has so many rows; one that cannot is replaced by one that can."""
    column = file[name]
    if column.maxshape[0] is not None:
        values, about = column[()], dict(column.attrs)
        del file[name]
        column = file.create_dataset(
            name, data=values, maxshape=(None, *values.shape[1:]), chunks=(256, *values.shape[1:]),
            compression="gzip", shuffle=True, fletcher32=True,
        )  # fmt: skip
        column.attrs.update(about)
    column.resize(rows, axis=0)


def resize(file, rng):
    """Resize data sets of a file, and make the checksums right as far as they can be computed."""
    sets = []
    file.visititems(lambda n, o: sets.append(n) if isinstance(o, h5py.Dataset) else None)
    chosen = rng.sample(sorted(sets), rng.choice([1, 1, 3]))
    rows = rng.choice([0, 3, 10**4, 10**5, 1 << 26, 1 << 28, 1 << 33, 1 << 55])
    for name in chosen:
        stretch(file, name, rows)
    if rows <= 10**5:
        columns = {name: file["history"][name] for name in file["history"].dtype.names}
        file["history"].attrs["digest"] = np.uint32(array_digest(columns))
    return f"{chosen} resized to {rows}"


def check(number, folder):
    """Forge a folder and read it in all ways; return 0 where nothing raw is raised."""
    folder = Path(folder)
    print(forge(folder, random.Random(number)), flush=True)
    limit_memory(MEMORY)
    return read(folder)


def read(folder):
    """Read a folder in all ways; what cannot be read is refused in words, or a raw error rises."""
    for way in (_frames, _tables, _resumed):
        try:
            way(folder)
        except mc.MulticellError as error:
            assert len(str(error)) < 3000  # noqa: PT017
            print(f"{way.__name__} refused: {error}", flush=True)
    return 0


def _frames(folder):
    result = mc.load_result(folder)
    repr(result)
    for k in range(len(result.frames)):
        try:
            repr(result.frames[k])
            repr(result.frames[k].cells)
        except mc.OutputError as error:
            print(f"frame {k} refused: {error}", flush=True)


def _tables(folder):
    mc.export(folder, folder / "tables", overwrite=True)


def _resumed(folder):
    last = len(mc.load_result(folder).frames) - 1
    mc.resume(folder, last, output=folder / "again", report=False, threads=1)
