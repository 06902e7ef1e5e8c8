"""A solid bead with an image of the PSF, by the default command: is its diameter within 2 %?

``python -m benchmarks.bead --page docs/effects.md``. Beads of three diameters in a widefield
microscope, at 60 photons, and a point seen by the same one, with 1500, as the image of the PSF.
Both go to ``napari-deltamic fit BEAD --voxel-size ... --seeds CSV --psf POINT``, once as it is and
once with the PSF held. The diameter is that of the ball of the same volume.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import napari_deltamic as nd
from napari_deltamic.geometry import sphere
from napari_deltamic.images.stacks import read_image, write_image
from napari_deltamic.optics import PupilPSF
from napari_deltamic.scene import Points, Scene, Solid

from .figure import Row, at_most, default_data_folder
from .page import put_between, table

VOXEL = (0.25, 0.11, 0.11)
OPTICS = PupilPSF(1.2, 0.52, 1.333, {5: 0.2, 11: -0.3}, extent=(2.5, 2.0))
PHOTONS, POINT_PHOTONS, WITHIN = 60.0, 1500.0, 2.0
DIAMETERS = (1.8, 2.5, 3.6)  # um
REAL, REAL_PSF = "images/bead2.5um_EPFL_25pct.tif", "psf/THEOR_EPFL_bead_25pct.tif"
REAL_DIAMETER, REAL_VOXEL = 2.5, (0.64, 0.258, 0.258)
REAL_CROP = (slice(13, 38), slice(11, 51), slice(11, 51))  # without the beads nearby


def diameter(mesh: nd.Mesh) -> float:
    """um: of the ball of the largest cell's volume."""
    volume = max(abs(v) for v in mesh.volumes().values())
    return float(np.cbrt(6 * volume / np.pi))


def found(folder: Path, middle: Sequence[float], radius: float, *options: str) -> nd.Mesh:
    """What the command makes of ``bead.tif`` and ``psf.tif`` of a folder."""
    z, y, x = middle
    (folder / "seeds.csv").write_text(f"z,y,x,radius\n{z},{y},{x},{radius}\n")
    words = ["fit", "bead.tif", "--seeds", "seeds.csv", "--psf", "psf.tif", *options]
    done = subprocess.run(
        [sys.executable, "-m", "napari_deltamic", *words, "-o", "out", "--overwrite"],
        capture_output=True,
        text=True,
        cwd=folder,
    )
    if done.returncode:
        raise SystemExit(done.stderr.strip().splitlines()[-1])
    print(done.stderr.strip().splitlines()[-1], file=sys.stderr, flush=True)
    return nd.load_mesh(folder / "out" / "mesh.ply")


def simulated(folder: Path) -> list[Row]:
    """Beads of known diameter."""
    rows = []
    for number, true in enumerate(DIAMETERS):
        grid = nd.Grid((int((true + 3.5) / VOXEL[0]), *[int((true + 2.4) / VOXEL[1])] * 2), VOXEL)
        middle = np.mean(grid.extent, axis=0) + np.array([0.06, -0.04, 0.03])
        bead = Solid(sphere(middle, true / 2, edge_length=0.08))
        scenes = Scene((bead,), OPTICS), Scene((Points(middle[None]),), OPTICS)
        made, seen = (
            nd.simulate(scene, grid, photons=photons, background=3.0, seed=number)
            for scene, photons in zip(scenes, (PHOTONS, POINT_PHOTONS), strict=True)
        )
        for name, image in (("bead", made.image), ("psf", seen.image)):
            write_image(folder / f"{name}.tif", image.astype(np.float32), VOXEL)
        # A start that is off by a tenth in size and place.
        for what, options in (("", ()), (", PSF held", ("--no-fit-psf",))):
            got = diameter(found(folder, middle + 0.05 * true, 0.45 * true, *options))
            off = 100 * abs(got / true - 1)
            figure = f"bead of {true:g} um{what}: error of its diameter"
            rows.append(at_most(figure, WITHIN, off, "%", f"{got:.3f} um"))
    return rows


def real(folder: Path, data: Path) -> list[Row]:
    """The one there is, whose own PSF and size are not certain (docs/effects.md)."""
    image, psf = data / REAL, data / REAL_PSF
    if not (image.is_file() and psf.is_file()):
        return []
    whole = read_image(image)[0].astype(np.float32)[REAL_CROP]
    light = read_image(psf)[0].astype(np.float32)
    write_image(folder / "bead.tif", whole, REAL_VOXEL)
    write_image(folder / "psf.tif", light, REAL_VOXEL)
    middle = (np.asarray(whole.shape) - 1) / 2 * np.asarray(REAL_VOXEL)
    got = diameter(found(folder, middle.tolist(), REAL_DIAMETER / 2, "--no-fit-psf"))
    off = 100 * abs(got / REAL_DIAMETER - 1)
    return [at_most("real bead: error of its diameter", WITHIN, off, "%", f"{got:.3f} um")]


def main(argv: Sequence[str]) -> int:
    """Returns 1 if a figure falls short of what was asked."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.bead", description=__doc__)
    parser.add_argument("--data", type=Path, default=default_data_folder())
    parser.add_argument("--page", type=Path, metavar="FILE", help="whose figures are replaced")
    chosen = parser.parse_args(argv)
    with tempfile.TemporaryDirectory() as name:
        rows = [*simulated(Path(name)), *real(Path(name), chosen.data)]
    print(table(rows))
    if chosen.page is not None:
        put_between(chosen.page, "bead", table(rows))
    return 1 if any(row.passed is False for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
