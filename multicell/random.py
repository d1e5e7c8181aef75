"""Random numbers that depend on what they are for, not on when or where they are drawn.

A number is a pure function of (seed, purpose, step, cell id): the same seed gives the same bits
whatever the order of the cells, the number of threads, the integration method or a resume in
between. The generator is Philox4x64-10, whose counter mode needs no state at all.

References
----------
J. K. Salmon, M. A. Moraes, R. O. Dror, D. E. Shaw, "Parallel random numbers: as easy as 1, 2, 3",
Proc. SC11 (2011), https://doi.org/10.1145/2063384.2063405
"""

from __future__ import annotations

from enum import IntEnum
from typing import final

import numpy as np
from numpy.typing import NDArray

from multicell.cells import FloatArray, IntArray
from multicell.errors import SceneError

UIntArray = NDArray[np.uint64]

_WORD = 2**64  # values of a random word
_SPARE = np.uint64(11)  # bits of a word that a number has no room for
GOLDEN = 0.5 * (5.0**0.5 - 1.0)  # golden section: its multiples spread evenly over 0 ... 1


@final
class Purpose(IntEnum):
    """Purpose of a random number; the values are part of every result and never change."""

    PLACEMENT = 1
    STAGE = 2
    CYCLE = 3
    MODULI = 4
    AXIS = 5
    SEPARATION = 6
    KIND = 7
    MOTILITY = 8
    PHASES = 9
    APOPTOSIS = 10
    NECROSIS = 11
    CONDITIONING = 12
    EIGENVECTOR = 13
    VIEW = 14
    RENEWAL = 15
    REST = 16
    CHANGE = 17
    MUTATION = 18
    RADIATION = 19
    DRIFT = 20
    TOLERANCE = 21
    ASYMMETRY = 22
    NETWORK = 23
    NETWORK_DIVISION = 24
    BROWNIAN = 25


def philox(counter: UIntArray, key: tuple[int, int]) -> UIntArray:
    """Return the Philox4x64-10 block of each counter.

    - ``counter``, (4, ...) uint64: four words a block
    - ``key``: two words, each in 0 ... 2**64 - 1

    Returns (4, ...) uint64: four random words a block, bit for bit those of
    ``numpy.random.Philox``.
    """
    # numba is loaded by what draws numbers, not by what only names their purposes
    from multicell.philox import philox_blocks

    words = np.ascontiguousarray(counter, dtype=np.uint64).reshape(4, -1)
    out = np.empty_like(words)
    philox_blocks(words, np.uint64(key[0]), np.uint64(key[1]), out)
    return out.reshape(counter.shape)


def thresholds(
    seed: int, purpose: Purpose, event: int | IntArray, ids: NDArray[np.int64]
) -> FloatArray:
    """Return the integral of its rate at which the event of each cell comes to pass, (n,).

    Exponential with mean 1, so that events come as those of a Poisson process whatever the rate.
    ``event`` distinguishes events of the same cell, also by cell; the rest is as for
    :func:`uniform`.
    """
    return np.asarray(-np.log1p(-uniform(seed, purpose, event, ids)[:, 0]))


def uniform(
    seed: int,
    purpose: Purpose,
    event: int | IntArray,
    ids: NDArray[np.int64],
    count: int = 1,
    attempt: int = 0,
) -> FloatArray:
    """Return uniform random numbers in [0, 1) with 53 bits.

    - ``seed``: seed of the run, 0 ... 2**64 - 1
    - ``purpose``: what the numbers are for: purposes are independent of each other
    - ``event``: index of the coupling step or the event, 0 or more; one for all or of each cell
    - ``ids``, (n,) int64: identities of the cells, 0 or more
    - ``count``: numbers a cell
    - ``attempt``: distinguishes repeated draws for the same cell, event and purpose

    Returns (n, count) float64.

    Raises SceneError if the seed does not fit into 64 bits; ValueError if ``event``, ``count``,
    ``attempt`` or an identity is negative.
    """
    ids = np.asarray(ids, dtype=np.int64)
    if not 0 <= seed < _WORD:
        raise SceneError("seed", f"is {seed}, must be a whole number from 0 to 2**64 - 1")
    first = event if isinstance(event, int) else int(np.min(event, initial=0))
    if min(first, count, attempt) < 0 or np.count_nonzero(ids < 0):
        raise ValueError("event, count, attempt and cell ids must not be negative")
    blocks = -(-count // 4)
    counter = np.empty((4, len(ids), blocks), dtype=np.uint64)
    counter[0] = 0 if blocks == 1 else np.arange(blocks, dtype=np.uint64)
    counter[1] = event if isinstance(event, int) else np.reshape(event, (-1, 1))
    counter[2] = ids[:, None]
    counter[3] = attempt
    words = philox(counter, (seed, int(purpose))).transpose(1, 2, 0)
    bits = words.reshape(len(ids), 4 * blocks)[:, :count] >> _SPARE
    return np.asarray(bits * 2.0**-53)


def normal(
    seed: int,
    purpose: Purpose,
    event: int,
    ids: NDArray[np.int64],
    count: int = 1,
    attempt: int = 0,
) -> FloatArray:
    """Return standard normal random numbers, (n, count), by the method of Box and Muller.

    Parameters and errors are those of :func:`uniform`.
    """
    pairs = -(-count // 2)
    u = uniform(seed, purpose, event, ids, 2 * pairs, attempt)
    # 1 - u lies in (0, 1]: its logarithm is finite
    length = np.sqrt(-2.0 * np.log(1.0 - u[:, :pairs]))
    angle = 2.0 * np.pi * u[:, pairs:]
    if count == 1:
        return np.asarray(length * np.cos(angle))
    both = np.concatenate([length * np.cos(angle), length * np.sin(angle)], axis=1)
    return np.ascontiguousarray(both[:, :count])


def truncated_normal(
    seed: int, purpose: Purpose, event: int, ids: NDArray[np.int64], limit: float = 3.0
) -> FloatArray:
    """Return standard normal random numbers with ``abs(z) <= limit``, (n,).

    Numbers outside are drawn again (never moved to the limit), so the distribution is the normal
    one conditioned on the interval. ``limit`` is at least 0.1; other parameters and errors are
    those of :func:`uniform`.
    """
    if not limit >= 0.1:
        raise ValueError(f"limit is {limit}, must be at least 0.1")
    ids = np.asarray(ids, dtype=np.int64)
    z = normal(seed, purpose, event, ids)[:, 0]
    attempt = 0
    (outside,) = (np.abs(z) > limit).nonzero()
    while outside.size:
        attempt += 1
        z[outside] = normal(seed, purpose, event, ids[outside], attempt=attempt)[:, 0]
        outside = outside[np.abs(z[outside]) > limit]
    return z


def directions(
    seed: int, purpose: Purpose, event: int, ids: NDArray[np.int64], dimensions: int
) -> FloatArray:
    """Return random unit vectors (n, 3), spread uniformly.

    On the sphere, where by Archimedes' theorem the height is uniform in [-1, 1) and the azimuth
    uniform in [0, 2 pi), or in two dimensions in its equator. Parameters and errors are those of
    :func:`uniform`.
    """
    u = uniform(seed, purpose, event, ids, dimensions - 1)
    azimuth = 2.0 * np.pi * u[:, -1]
    found = np.zeros((len(azimuth), 3))
    found[:, 0], found[:, 1] = np.cos(azimuth), np.sin(azimuth)
    if dimensions == 3:
        height = 2.0 * u[:, 0] - 1.0
        found[:, :2] *= np.sqrt((1.0 - height) * (1.0 + height))[:, None]
        found[:, 2] = height
    return found
