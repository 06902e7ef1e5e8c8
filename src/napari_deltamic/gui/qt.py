"""What the bindings' type stubs do not agree on."""

from __future__ import annotations

from typing import Any

from qtpy import QtCore, QtGui

Signal: Any = QtCore.Signal  # type: ignore[attr-defined]
QAction: Any = QtGui.QAction  # type: ignore[attr-defined]
