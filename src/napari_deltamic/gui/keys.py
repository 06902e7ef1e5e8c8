"""Keys of the viewer for what is done often; napari takes none from a manifest."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any


class Keys:
    """Binds keys of a viewer to actions until it is closed.

    Parameters
    ----------
    viewer : a napari viewer or its model.
    actions : by key, as napari writes them.
    """

    def __init__(self, viewer: Any, actions: Mapping[str, Callable[[], Any]]) -> None:
        self._viewer, self._keys = viewer, list(actions)
        for key, action in actions.items():
            viewer.bind_key(key, partial(_press, action), overwrite=True)

    def close_links(self) -> None:
        """Give the keys back."""
        for key in self._keys:
            self._viewer.bind_key(key, None, overwrite=True)
        self._keys = []


def _press(action: Callable[[], Any], viewer: Any) -> None:
    action()
