"""Columns of an AnnData file: what is known of its observations, and where they are."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np

from multicell.errors import DataError
from multicell.host.extras import needs

HDF5: Final = b"\x89HDF\r\n\x1a\n"
"""What such a file begins with."""


def h5ad_columns(path: Path, known: Callable[[str], bool]) -> dict[str, Any]:
    """Return the columns of a file by title: of ``obs``, of ``X``, and ``obsm["spatial"]`` in µm.

    - ``known``: whether a title is wanted; annotations of other programs are left out

    Raises DataError if it is no AnnData file, or none with coordinates.
    """
    needs("anndata")
    import anndata

    try:
        data = anndata.read_h5ad(path)
    except Exception as error:  # of several libraries
        raise DataError(path.name, f"is no AnnData file: {error}") from None
    found: dict[str, Any] = {title: data.obs[title].astype(object) for title in data.obs}
    numbers = {title: title not in found for title in data.var_names}
    found = {title: np.asarray(column) for title, column in found.items() if known(title)}
    for title in (title for title, new in numbers.items() if new and known(title)):
        column = data[:, title].X
        found[title] = np.asarray(column.todense() if hasattr(column, "todense") else column)
        found[title] = found[title].ravel()
    if "spatial" in data.obsm:
        place = np.asarray(data.obsm["spatial"])
        found |= {f"position_{axis}_um": x for axis, x in zip("xyz", place.T, strict=False)}
    return found
