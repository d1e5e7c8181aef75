"""Cells of many founders that divide: exponential cycles, and who descends from whom."""

import numpy as np

INSTANT = {"duration": "1 s"}


def cycle_of(mean, variation):
    """Return the phases of a cycle of which G1 is all but 3 s, with a gamma distribution."""
    first = {"duration": mean - 3.0, "distribution": "gamma", "variation": variation}
    return {"G1": first, "S": INSTANT, "G2": INSTANT, "M": INSTANT}


def founders(run):
    """Return the founder and the generation of every cell that ever was, by its identity."""
    table = run.lineage.table()
    ids, parents = table["id"], table["parent"]
    founder, generation = np.array(ids), np.zeros(len(ids), dtype=int)
    born = np.flatnonzero(parents >= 0)
    # parents have smaller ids, so that each is known before its daughters
    for row, mother in zip(born, np.searchsorted(ids, parents[born]), strict=True):
        founder[row], generation[row] = founder[mother], generation[mother] + 1
    return dict(
        zip(ids.tolist(), zip(founder.tolist(), generation.tolist(), strict=True), strict=True)
    )


def by_founder(run, chosen):
    """Return how many of the chosen cells each founder has, for founders 0 to the largest."""
    known = founders(run)
    of = np.array([known[i][0] for i in run.cells.id[chosen].tolist()], dtype=int)
    count = int((run.lineage.table()["parent"] < 0).sum())
    return np.bincount(of, minlength=count)
