"""Regions that points name: dark insides, or else the cells that *Find cells* sees there."""

from __future__ import annotations

from hashlib import sha1

import numpy as np
from numpy.typing import NDArray

from napari_deltamic.errors import InputError
from napari_deltamic.geometry.labels.basins import label_basins
from napari_deltamic.geometry.mesh import FloatArray, IntArray
from napari_deltamic.geometry.refused import Refused

Labels = NDArray[np.int32]
_OWN = 0.5  # chosen: most of a cell must be left by regions that other points name


def regions_at(
    data: FloatArray, size: FloatArray, voxels: IntArray, names: list[int]
) -> tuple[Labels, list[Refused]]:
    """Label the region of each voxel in ``voxels`` (n, 3) with its name; 0 elsewhere.

    That of :func:`~.basins.label_basins`. Where nothing dark closes around a point, as in a nucleus
    or in a cell that the border of the image cuts, it is the cell that is found there without help.
    Points without either are told.
    """
    labels, refused = label_basins(data, size, voxels, names)
    at = {name: tuple(voxel) for name, voxel in zip(names, voxels.tolist(), strict=True)}
    open_ones = [one for one in refused if len(one.points) == 1]
    cells = _cells(data, size) if open_ones else None
    if cells is None:
        return labels, refused
    taken: dict[int, int] = {}  # cell: the point that has it
    left = [one for one in refused if one not in open_ones]
    for one in open_ones:
        name = one.points[0]
        cell = int(cells[at[name]])
        own = (cells == cell) & (labels == 0)
        if cell in taken:
            text = f"points {taken[cell]} and {name} lie in the same region"
            left.append(Refused(text, (taken[cell], name)))
        elif cell and own.sum() > _OWN * (cells == cell).sum():
            labels[own], taken[cell] = name, name
        else:
            left.append(one)
    return labels, left


# The cells of the image that was looked at last: every click of a user asks for them again.
_kept: list[tuple[bytes, Labels | None]] = []


def _cells(data: FloatArray, size: FloatArray) -> Labels | None:
    """(Z, Y, X) those that are found without help; None where there are none."""
    content = sha1(data.tobytes(), usedforsecurity=False)
    content.update(repr((data.shape, size.tolist())).encode())
    key = content.digest()
    for known, cells in tuple(_kept):  # threads may share it
        if known == key:
            return cells
    found = _found(data, size)
    _kept[:] = [(key, found)]
    return found


def _found(data: FloatArray, size: FloatArray) -> Labels | None:
    # Imported where it is needed, as that takes a while.
    from napari_deltamic.geometry.labels.bright_cells import cells_of

    try:
        return cells_of(data, size.tolist()).labels
    except InputError:
        return None
