"""Result folders: written from frames, and their content to the bit."""

import h5py
from synthetic import SCENE, history_of

from multicell.results.writer import Store


def contents(folder):
    """Return type, shape and bytes of every data set of a result file, by its path."""
    found = {}

    def visit(name, item):
        if isinstance(item, h5py.Dataset):
            values = item[()]
            found[name] = (str(values.dtype), values.shape, values.tobytes())

    with h5py.File(folder / "frames.h5", "r") as file:
        file.visititems(visit)
    return found


def assert_same_bits(one, other):
    """Compare what two folders hold, and name what differs."""
    here, there = contents(one), contents(other)
    assert set(here) == set(there)
    assert [name for name in here if here[name] != there[name]] == []


def written(folder, frames, scene=SCENE, *, settle=True):
    store = Store.create(folder, scene)
    for frame, row in zip(frames, history_of(frames), strict=True):
        store.append_history(row)
        store.append(frame)
    if settle:
        store.settle()
    store.close()
    return folder
