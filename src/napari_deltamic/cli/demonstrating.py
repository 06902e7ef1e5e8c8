"""``napari-deltamic demo``: a fit whose truth is known, in a window or into a folder."""

from __future__ import annotations

import argparse
from importlib.util import find_spec
from pathlib import Path

from .._sample_data import dividing_cell_sample
from ..demo import demo_settings, has_display, run_headless, start_mesh
from .messages import Notes


def run(arguments: argparse.Namespace, notes: Notes) -> int:
    """Open napari and show the fit; without a display or napari, fit and write."""
    notes.release()
    sample, folder = dividing_cell_sample(), Path(arguments.output)
    window = not arguments.headless and has_display()
    if window and find_spec("napari") is None:
        notes.add("napari is not installed, so the results are written: 'pip install napari[all]'")
        window = False
    if window:
        from ..gui.live_demo import show  # needs Qt and napari, which the rest does without

        show(sample, start_mesh(sample), demo_settings(sample, folder))
    else:
        run_headless(sample, folder)
    return 0
