"""A picture of each effect: sections of two cells with it, and what it adds to the image."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from napari_deltamic import GaussianPSF
from napari_deltamic.scene import expected_image
from napari_deltamic.scene.effects import Effects

from .shape import DARK, PHOTONS, SIGMA, VOXEL, cases, scenes

_MOST = 4.0  # photons: end of the scale of differences


def effects_picture(path: Path) -> None:
    """Sections along the optical axis: the image without noise, and minus that of the plain scene.

    Needs matplotlib.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    scene = scenes()[-1]
    optics = GaussianPSF(SIGMA)
    plain = expected_image(scene.truth, scene.grid, optics, 1e-4, 1.0, 0.0)
    given = scene.truth, scene.grid, optics, 1e-4, PHOTONS / float(plain.max()), DARK
    images = {"none": expected_image(*given)}
    for name, effect in cases():
        images[name] = expected_image(*given, effects=Effects.of(effect))
    figure, axes = pyplot.subplots(
        2, len(images), figsize=(2.1 * len(images), 3.4), layout="constrained"
    )
    shown = {"aspect": VOXEL[0] / VOXEL[2], "interpolation": "nearest"}
    for (name, image), (above, below) in zip(images.items(), axes.T, strict=True):
        section = _section(image)
        above.imshow(section, cmap="gray", vmin=0, vmax=PHOTONS + DARK, **shown)
        above.set_title(name.replace(", ", ",\n"), fontsize=8)
        added = section - _section(images["none"])
        last = below.imshow(added, cmap="RdBu_r", vmin=-_MOST, vmax=_MOST, **shown)
    for axis in axes.flat:
        axis.set_axis_off()
    figure.colorbar(last, ax=axes, label="photons added (below)", shrink=0.9, pad=0.01)
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


def _section(image: np.ndarray) -> np.ndarray:
    """(Z, X), through the middle."""
    return image[:, image.shape[1] // 2]
