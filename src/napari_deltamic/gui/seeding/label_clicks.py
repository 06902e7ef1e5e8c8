"""What was corrected in a Labels layer, noted in its metadata: it goes where the layer goes.

Under the plugin's key lie ``clicks``, a row for each click (plain values, which a session keeps as
they are), and ``before``: what each correction changed, to undo it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...geometry import Click
from ..viewing.frame import OWN

_CLICKS, _BEFORE = "clicks", "before"
_ARRAYS = ("undo_clicks", "undo_voxels", "undo_places", "undo_values")


@dataclass(frozen=True, eq=False)
class Before:
    """What a correction replaced.

    clicks : how many it was made of.
    places : (n,) int64 indices of voxels, counted through the whole array.
    values : (n,) their labels before.
    """

    clicks: int
    places: NDArray[np.int64]
    values: NDArray[np.int64]


def clicks_of(layer: Any) -> list[Click]:
    """The clicks by which a layer was corrected, oldest first."""
    rows = layer.metadata.get(OWN, {}).get(_CLICKS, ())
    return [Click((z, y, x), action, step) for z, y, x, action, step in rows]


def put(layer: Any, places: NDArray[np.int64], values: NDArray[np.int64]) -> NDArray[np.int64]:
    """Set voxels of a layer; the labels that they had."""
    data, high = layer.data, int(values.max(initial=0))
    fits = (
        isinstance(data, np.ndarray) and data.flags.writeable and high <= np.iinfo(data.dtype).max
    )
    if not fits:  # a file, or a kind of number that is too small
        layer.data = data = np.array(data, np.int32)
    where = np.unravel_index(places, data.shape)
    before: NDArray[np.int64] = data[where].astype(np.int64)
    data[where] = values
    layer.refresh()
    return before


def note(layer: Any, clicks: Sequence[Click], before: Before) -> None:
    """Note a correction that was made."""
    own = layer.metadata.setdefault(OWN, {})
    rows = [[*map(float, c.place), c.action, c.step] for c in clicks]
    own[_CLICKS] = [*own.get(_CLICKS, ()), *rows]
    own[_BEFORE] = [*own.get(_BEFORE, ()), before]


def can_undo(layer: Any) -> bool:
    """Whether there is a correction to undo."""
    return bool(layer.metadata.get(OWN, {}).get(_BEFORE))


def undo(layer: Any) -> None:
    """Undo the last correction; what was painted elsewhere since stays."""
    own = layer.metadata[OWN]
    *rest, last = own[_BEFORE]
    if last.places.max(initial=-1) >= layer.data.size:
        forget(layer)  # its array was replaced by another one
        return
    put(layer, last.places, last.values)
    own[_BEFORE] = rest
    own[_CLICKS] = own[_CLICKS][: len(own[_CLICKS]) - last.clicks]


def forget(layer: Any) -> None:
    """The labels are others: nothing of them was corrected."""
    for key in (_CLICKS, _BEFORE):
        layer.metadata.get(OWN, {}).pop(key, None)


def undo_arrays(layer: Any) -> dict[str, NDArray[Any]]:
    """What a session keeps so that corrections can be undone after it; empty for none."""
    steps: Sequence[Before] = layer.metadata.get(OWN, {}).get(_BEFORE, ())
    if not steps:
        return {}
    parts = (
        np.array([step.clicks for step in steps]),
        np.array([len(step.places) for step in steps]),
        np.concatenate([step.places for step in steps]),
        np.concatenate([step.values for step in steps]),
    )
    return dict(zip(_ARRAYS, parts, strict=True))


def with_undo(own: dict[str, Any], arrays: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
    """What is known of a layer, with what ``undo_arrays`` gave."""
    if any(name not in arrays for name in _ARRAYS):
        return own
    clicks, voxels, places, values = (arrays[name] for name in _ARRAYS)
    ends = np.cumsum(voxels)[:-1]
    parts = zip(clicks, np.split(places, ends), np.split(values, ends), strict=True)
    return {**own, _BEFORE: [Before(int(n), p, v) for n, p, v in parts]}
