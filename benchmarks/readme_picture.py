"""The picture at the top of the README: ``python -m benchmarks.readme_picture RESULT PICTURE``.

RESULT is the folder of a fit. The picture shows what the fit found: meshes, and rendered slices
with their contours. It holds no voxel of the measured stack, whose licence may not allow it.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.colors import LightSource

from napari_deltamic import Mesh, load_mesh
from napari_deltamic.images import read_image
from napari_deltamic.measure import section

COLOURS = ("#ffb000", "#56b4e9", "#ff6f91", "#7fd67f", "#c792ea")
SLICES = 2


def shapes(axes: plt.Axes, mesh: Mesh) -> None:
    """The meshes in 3D, lit from above."""
    light = LightSource(azdeg=300, altdeg=50)
    for k, region in enumerate(r for r in mesh.region_ids() if r != 0):
        cell = mesh.region_surface(region)
        v = cell.vertices_numpy()
        axes.plot_trisurf(  # type: ignore[attr-defined]
            v[:, 2], v[:, 1], v[:, 0], triangles=cell.faces,
            color=COLOURS[k % len(COLOURS)], lightsource=light, linewidth=0.1,
            edgecolor="#00000030",
        )  # fmt: skip
    low, high = mesh.bounds()
    axes.set_box_aspect((np.asarray(high) - low)[::-1], zoom=1.7)  # type: ignore[attr-defined]
    axes.view_init(elev=28, azim=-65)  # type: ignore[attr-defined]
    axes.set_axis_off()


def contours(axes: plt.Axes, image: np.ndarray, mesh: Mesh, size: tuple, position: float) -> None:
    """One rendered slice with the sections of the meshes."""
    plane = image[round(position / size[0])]
    height, width = (n * d for n, d in zip(plane.shape, size[1:], strict=True))
    extent = (-size[2] / 2, width - size[2] / 2, height - size[1] / 2, -size[1] / 2)
    low, high = np.percentile(image, (1, 99.8))
    axes.imshow(plane, cmap="gray", extent=extent, vmin=low, vmax=high)
    for k, region in enumerate(r for r in mesh.region_ids() if r != 0):
        segments, _ = section(mesh.region_surface(region), 0, position)
        axes.add_collection(
            LineCollection(
                list(segments[..., ::-1]), colors=COLOURS[k % len(COLOURS)], linewidths=1.3
            )
        )
    axes.set_title(f"rendered, z = {position:.2f} um", fontsize=9, color="white")
    axes.set_axis_off()


def main() -> None:
    """Draw the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("result", type=Path)
    parser.add_argument("picture", type=Path)
    arguments = parser.parse_args()
    mesh = load_mesh(arguments.result / "mesh.rec")
    image, size = read_image(arguments.result / "rendered.tif")
    report = json.loads((arguments.result / "report.json").read_text())
    figure = plt.figure(figsize=(12, 4.2), facecolor="#181818")
    shapes(figure.add_subplot(1, SLICES + 1, 1, projection="3d", facecolor="#181818"), mesh)
    low, high = mesh.bounds()
    for k, share in enumerate(np.linspace(0.3, 0.55, SLICES)):
        axes = figure.add_subplot(1, SLICES + 1, k + 2)
        plane = round((low[0] + share * (high[0] - low[0])) / size[0]) * size[0]
        contours(axes, image, mesh, size, plane + 1e-6)
    figure.text(
        0.01, 0.03, f"{report['iterations']} iterations, {report['seconds']:.0f} s on a CPU",
        color="white", fontsize=9,
    )  # fmt: skip
    figure.tight_layout()
    figure.savefig(arguments.picture, dpi=100)


if __name__ == "__main__":
    main()
