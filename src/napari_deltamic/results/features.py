"""Measurements of cells as columns, for layers and other tables."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray


def features_of(rows: Iterable[Mapping[str, Any]]) -> dict[str, NDArray[Any]]:
    """Rows of cells as features of a Labels layer, one for each label; empty columns are left out.

    The column ``index`` is what napari takes for the label.
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
    """The same for the vertices of a Surface layer, of which each lies on a cell."""
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
        if values.dtype.kind == "f":  # words would take much memory, a copy for each vertex
            found[name] = np.where(known, values[row], np.nan)
    return found
