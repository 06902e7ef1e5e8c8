"""The widgets that the manifest names."""

from __future__ import annotations

from .gui.fit_widget import FitWidget
from .gui.small_widgets import measure_widget, simulate_widget

__all__ = ["FitWidget", "measure_widget", "simulate_widget"]
