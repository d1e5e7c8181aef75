"""How many threads the kernels may use."""

from __future__ import annotations

from multicell.errors import SceneError


def thread_count(wanted: int | None) -> int:
    """Return the number of threads to use, and let numba know it.

    Parameters
    ----------
    wanted
        Number of threads, or None for all that there are.

    Raises
    ------
    SceneError
        If there are not as many.
    """
    import numba

    most = int(numba.config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]
    if wanted is None:
        wanted = most
    if not 1 <= wanted <= most:
        raise SceneError(
            "threads", f"is {wanted}, must be from 1 to {most}", "NUMBA_NUM_THREADS sets the limit."
        )
    if wanted > 1:
        numba.set_num_threads(wanted)
    return wanted
