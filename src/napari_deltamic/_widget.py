"""The widgets that the manifest names."""

from __future__ import annotations

from .gui.fit_widget import FitWidget
from .gui.measure_layer import measure_widget
from .gui.simulate_widget import simulate_widget

__all__ = ["FitWidget", "measure_widget", "simulate_widget"]
