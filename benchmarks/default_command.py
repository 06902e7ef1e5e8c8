"""``napari-deltamic fit`` as a user calls it: an image, its voxel size, seeds, and nothing else."""

from __future__ import annotations

import csv
import json
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

from napari_deltamic import Mesh, load_mesh
from napari_deltamic.cli import main
from napari_deltamic.images.stacks import read_image


@dataclass(frozen=True, eq=False)
class Outcome:
    """What the command left.

    mesh, rendered : the surfaces, and the image (Z, Y, X) that they make.
    report : what it says of the fit.
    seconds, cpu : of the whole command, by the clock and summed over the cores.
    """

    mesh: Mesh
    rendered: NDArray[np.float32]
    report: dict[str, Any]
    seconds: float
    cpu: float

    @property
    def note(self) -> str:
        """How the fit ended, in words."""
        told = "converged" if self.report["converged"] else "not converged"
        return f"{self.report['iterations']} iterations, {self.report['seconds']:.0f} s; {told}"


def fitted(
    image: Path | NDArray[Any],
    voxel_size: Sequence[float],
    seeds: Path | NDArray[Any],
    further: Sequence[str] = (),
) -> Outcome:
    """The fit of an image, or of the file of one.

    seeds : the file of any kind; labels (Z, Y, X); or points (N, 3), um, with radii (N, 4).
    further : words of the command.
    """
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        if not isinstance(image, Path):
            np.save(folder / "image.npy", image)
            image = folder / "image.npy"
        if not isinstance(seeds, Path):
            seeds = _written(folder, np.asarray(seeds))
        out, size = folder / "result", map(str, voxel_size)
        words = ["fit", str(image), "--voxel-size", *size, "--seeds", str(seeds), *further]
        begun, begun_cpu = time.perf_counter(), time.process_time()
        code = main([*words, "-o", str(out)])
        seconds, cpu = time.perf_counter() - begun, time.process_time() - begun_cpu
        if code != 0:
            raise RuntimeError(f"the fit ended with code {code}")
        report = json.loads((out / "report.json").read_text())
        rendered = read_image(out / "rendered.tif")[0].astype(np.float32)
        return Outcome(load_mesh(out / "mesh.rec"), rendered, report, seconds, cpu)


def _written(folder: Path, seeds: NDArray[Any]) -> Path:
    if seeds.ndim == 3:
        path = folder / "labels.tif"
        tifffile.imwrite(path, seeds.astype(np.uint16))
        return path
    return write_points(folder / "centres.csv", seeds)


def write_points(path: Path, points: NDArray[Any]) -> Path:
    """Points (N, 3), um, or with radii (N, 4), as the command line takes them."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(("z", "y", "x", "radius")[: points.shape[1]])
        writer.writerows(points.tolist())
    return path
