"""What the bindings' type stubs do not agree on."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from qtpy import QtCore, QtGui

Signal: Any = QtCore.Signal  # type: ignore[attr-defined]
QAction: Any = QtGui.QAction  # type: ignore[attr-defined]


def action(title: str, tip: str, slot: Callable[[], object], parent: Any) -> Any:
    """An entry of a menu."""
    made = QAction(title, parent)
    made.setToolTip(tip)
    made.triggered.connect(lambda checked=False: slot())
    return made
