"""The animation in the README: ``python -m benchmarks.readme_animation docs/images/embryo.gif``.

A real fit, frame by frame: a C. elegans embryo (stack by N. Chiaruttini, LimeSeg, CC0), its cells
found automatically. Left the measured slice with the contours of
the mesh, right the slice of the image that is rendered from it.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from napari_deltamic import FitState, GaussianPSF, Grid, Mesh, fit
from napari_deltamic.geometry import find_cells, mesh_from_labels
from napari_deltamic.images.stacks import read_image
from napari_deltamic.measure import section
from napari_deltamic.results.colouring import COLOURS
from napari_deltamic.runs.settings import FitSettings

from .figure import MissingData, default_data_folder

VOXEL = (4.0, 1.0, 1.0)  # in pixels: the stack does not say what a pixel is in um
SIGMA = (4.0, 1.4, 1.4)
CELL, EDGE = 55.0, 5.0
PLANE, BOX = 17, (20, 236, 8, 384)  # slice, and its part in Y and X
FRAMES, SCALE = 40, 2  # drawn larger and reduced: smooth lines


def start(image: NDArray[np.float32]) -> Mesh:
    """One mesh of all cells that are found, with shared walls."""
    return mesh_from_labels(find_cells(image, VOXEL, CELL), VOXEL, edge_length=EDGE, gap=4.0)


def frame(image: NDArray[np.float32], state: FitState, low: float, high: float) -> Image.Image:
    """Both slices beside each other."""
    y0, y1, x0, x1 = BOX
    panels = []
    for pixels in (image, state.rendered()):
        part = np.clip((pixels[PLANE, y0:y1, x0:x1] - low) / (high - low), 0, 1) ** 0.7
        panel = Image.fromarray((255 * part).astype(np.uint8)).convert("RGB")
        panels.append(
            panel.resize((SCALE * (x1 - x0), SCALE * (y1 - y0)), Image.Resampling.BICUBIC)
        )
    draw = ImageDraw.Draw(panels[0])
    segments, faces = section(state.mesh, 0, PLANE * VOXEL[0] + 1e-6)
    for ends, region in zip(segments, state.mesh.regions[faces].max(1), strict=True):
        line = [
            SCALE * (c + 0.5 - o) for yx in ends for c, o in zip(yx[::-1], (x0, y0), strict=True)
        ]
        draw.line(line, fill=COLOURS[(int(region) - 1) % len(COLOURS)], width=3)
    whole = Image.new("RGB", (2 * panels[0].width + 8, panels[0].height))
    whole.paste(panels[0], (0, 0))
    whole.paste(panels[1], (panels[0].width + 8, 0))
    return whole.resize((whole.width // SCALE, whole.height // SCALE), Image.Resampling.LANCZOS)


def main() -> None:
    """Fit and draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("gif", type=Path)
    path = default_data_folder() / "images" / "celegans_tp33half_bgsub.tif"
    if not path.is_file():
        raise MissingData(f"no {path.name} at {path.parent}")
    image = read_image(path)[0].astype(np.float32)
    low, high = np.percentile(image, (50, 99.8))
    settings = FitSettings(levels=(2.0, 1.35, 1.0), density="smooth")
    began, states = time.perf_counter(), []
    mesh, grid = start(image), Grid(image.shape, VOXEL)
    for state in fit(image, grid, mesh, GaussianPSF(SIGMA), settings=settings):
        states.append(state)
    print(f"{len(states)} iterations, {time.perf_counter() - began:.0f} s; {state.message}")
    # More frames where more happens: at the beginning.
    chosen = np.unique((np.linspace(0, 1, FRAMES) ** 2 * (len(states) - 1)).astype(int))
    frames = [frame(image, states[k], low, high) for k in chosen]
    palette = frames[-1].quantize(96)
    small = [f.quantize(palette=palette, dither=Image.Dither.NONE) for f in frames]
    small[0].save(
        parser.parse_args().gif,
        save_all=True,
        append_images=small[1:],
        duration=[700] + [120] * (len(small) - 2) + [3000],
        loop=0,
        optimize=True,
    )


if __name__ == "__main__":
    main()
