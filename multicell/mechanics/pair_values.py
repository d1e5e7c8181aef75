"""Values that a law keeps for each pair: its entry for the two types, memory of contacts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from multicell.cells import FloatArray
from multicell.contact.law import PairLaw, effective_radius
from multicell.mechanics.forces import PairData
from multicell.mechanics.motion import Motion
from multicell.mechanics.neighbours import PairList, are_listed, listed


def has_pair_values(law: PairLaw, motion: Motion, pair_table: FloatArray | None) -> bool:
    """Return whether the law keeps values for each pair, which are made with each list."""
    typed = pair_table is not None and motion.kind is not None
    return law.remembers or typed or motion.sticky is not None


def pair_data(
    pairs: PairList,
    law: PairLaw,
    motion: Motion,
    pair_table: FloatArray | None,
    compliance: FloatArray,
) -> PairData:
    """Return a list with what the law keeps for each pair, as kernels take it.

    - ``pair_table``, (k, k), optional: over the types ``motion.kind``, of the law's entries; of a
      surface energy a pair has the geometric mean of its cells' factors ``motion.sticky``,
      Berthelot's rule
    - ``compliance``, (n,): of the cells, 1/kPa
    """
    if not has_pair_values(law, motion, pair_table):
        return PairData(*pairs.arrays, None, None, None)
    first, second = listed(pairs)
    entries: FloatArray | float | None = None
    if pair_table is not None and motion.kind is not None:
        entries = pair_table[motion.kind[first], motion.kind[second]]
    if motion.sticky is not None:
        own = law.surface_energy if entries is None else entries
        entries = own * np.sqrt(motion.sticky[first] * motion.sticky[second])
    adhesion = None if entries is None else np.ascontiguousarray(law.adhesion_of(entries))
    if not law.remembers:
        return PairData(*pairs.arrays, adhesion, None, None)
    modulus = 1.0 / (compliance[first] + compliance[second])
    unit, onset = _memory(
        law, motion, law.adhesion if adhesion is None else adhesion, modulus, first, second
    )
    return PairData(*pairs.arrays, adhesion, unit, onset)


def _memory(
    law: PairLaw,
    motion: Motion,
    adhesion: FloatArray | float,
    modulus: FloatArray,
    first: NDArray[np.int64],
    second: NDArray[np.int64],
) -> tuple[FloatArray, FloatArray]:
    """Return the law's unit of overlap with its rate, (2, m), and its onset, of pairs."""
    touching = are_listed(motion.touching, first, second, len(motion.radius))
    (begin, onset), (end, _) = (
        law.pair_memory(
            adhesion, modulus, effective_radius(radius[first], radius[second]), touching
        )
        for radius in (motion.radius, motion.end_radius)
    )
    length = motion.end - motion.begin
    rate = (end - begin) / length if length > 0.0 else np.zeros(len(first))
    return np.stack([begin, rate]), onset
