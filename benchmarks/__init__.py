"""Figures that the software is held to: ``python -m benchmarks --help``."""

import napari_deltamic  # noqa: F401  (before torch: how its idle threads wait, as for users)
