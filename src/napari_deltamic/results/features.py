"""Measurements of cells as columns, for layers and other tables."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray


def features_of(rows: Iterable[Mapping[str, Any]]) -> dict[str, NDArray[Any]]:
    """Convert rows of cells to the features of a Labels layer; empty columns are left out.

    napari reads the label of each row from the column ``index``.
    """
    table = list(rows)
    found: dict[str, NDArray[Any]] = {
        "index": np.array([int(row["region"]) for row in table], np.int64)
    }
    for name in table[0] if table else ():
        values = [row.get(name) for row in table]
        if name == "region" or all(value is None for value in values):
            continue
        empty = "" if any(isinstance(value, str) for value in values) else np.nan
        found[name] = np.array([empty if value is None else value for value in values])
    return found


def features_at(
    rows: Iterable[Mapping[str, Any]], regions: NDArray[np.int64]
) -> dict[str, NDArray[Any]]:
    """Convert them to features of a Surface layer, whose vertices lie on cells ``regions`` (V,)."""
    features = features_of(rows)
    index = features.pop("index")
    order = np.argsort(index)
    if not len(index):
        return {}
    at = np.minimum(np.searchsorted(index, regions, sorter=order), len(index) - 1)
    row = order[at]
    known = index[row] == regions
    found: dict[str, NDArray[Any]] = {"cell": regions}
    for name, values in features.items():
        if values.dtype.kind == "f":  # texts would take much memory, with a copy for each vertex
            found[name] = np.where(known, values[row], np.nan)
    return found
