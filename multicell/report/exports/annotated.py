"""Cells as observations with features, as scanpy and squidpy read them (AnnData)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import anndata
import numpy as np
import pandas
from numpy.typing import NDArray

from multicell.report.tables import TABLES, Frames, joined
from multicell.results.folder import versions
from multicell.results.observables import touching

if TYPE_CHECKING:
    from multicell.report.result import Result
    from multicell.results.frame import Frame

NAME: Final = "cells.h5ad"
_PLACE: Final = ("position_x_um", "position_y_um", "position_z_um")
_WHO: Final = ("frame", "time_s", "id", "parent", "state", "kind", "phase")


def write(run: Result, frames: Frames, folder: Path, tables: Sequence[str]) -> list[str]:
    """Write the cells of all frames into one file and return its name."""
    # the tables and the contacts each go through the frames
    table = joined(TABLES["cells"](run, frames()))
    features = [title for title in table if title not in (*_PLACE, *_WHO)]
    who = pandas.DataFrame({title: table[title] for title in _WHO if title in table})
    who.index = [f"{k}-{id}" for k, id in zip(who["frame"], who["id"], strict=True)]
    words = {title: "category" for title in ("state", "kind", "phase") if title in who}
    data = anndata.AnnData(
        X=np.column_stack([table[title].astype(float) for title in features]),
        obs=who.astype(words),
        var=pandas.DataFrame(index=features),
        obsm={"spatial": np.column_stack([table[title] for title in _PLACE])},
        uns={"scene": run.scene.to_toml(), "versions": versions()},
    )
    _connect(data, [frame for _, frame in frames()])
    data.write_h5ad(folder / NAME, compression="gzip")
    return [NAME]


def _connect(data: Any, frames: Sequence[Frame]) -> None:
    """Add who touches whom, and how far apart they are, under squidpy's names."""
    from scipy.sparse import coo_array

    pairs, apart, before = [np.empty((0, 2), np.int64)], [np.empty(0)], 0
    for frame in frames:
        rows, place = touching(frame), frame.cells.position
        pairs.append(before + rows)
        apart.append(np.linalg.norm(place[rows[:, 0]] - place[rows[:, 1]], axis=1))
        before += len(frame.cells)
    first, second = np.concatenate(pairs).T
    both = (np.concatenate([first, second]), np.concatenate([second, first]))
    distance: NDArray[np.float64] = np.tile(np.concatenate(apart), 2)
    shape = (data.n_obs, data.n_obs)
    data.obsp["spatial_connectivities"] = coo_array((np.ones(len(distance)), both), shape).tocsr()
    data.obsp["spatial_distances"] = coo_array((distance, both), shape).tocsr()
    data.uns["spatial_neighbors"] = {
        "connectivities_key": "spatial_connectivities",
        "distances_key": "spatial_distances",
        "params": {"coord_type": "generic", "radius": "cells in contact"},
    }
