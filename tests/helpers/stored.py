"""What stands in result folders, to the bit."""

import h5py


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
