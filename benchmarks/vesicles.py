"""Figures on a real image: vesicles, fitted from rough centres through the command line."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from napari_deltamic import Mesh
from napari_deltamic.geometry import labels_from_points, read_points_csv
from napari_deltamic.images.stacks import read_image
from napari_deltamic.measure import surface_distance

from .default_command import fitted
from .figure import Figure, MissingData, Options, Row, at_least, at_most
from .ridge import ridge_distance

CENTRES = Path(__file__).parent / "data_points" / "vesicles_GUV.csv"
VOXEL_SIZE = (0.34, 0.133, 0.133)


def words(image: Path, centres: Path) -> list[str]:
    """The command, but for where the results go."""
    size = [str(d) for d in VOXEL_SIZE]
    return ["fit", str(image), "--voxel-size", *size, "--seeds", str(centres)]


def shifted(image: np.ndarray, points: np.ndarray) -> tuple[list[np.ndarray], int, int]:
    """The centres moved by a quarter of the extent of their vesicle along each axis, both ways.

    A set of centres for each direction; a centre that would leave its vesicle stays. Also how many
    of the moves stay inside, and how many there are.
    """
    labels = labels_from_points(image, VOXEL_SIZE, points)
    sets, inside, tried = [], 0, 0
    for axis in range(3):
        for sign in (-1, 1):
            moved = points.copy()
            for k in range(len(points)):
                where = np.nonzero(labels == k + 1)[axis]
                quarter = (np.ptp(where) + 1) * VOXEL_SIZE[axis] / 4
                candidate = points[k].copy()
                candidate[axis] += sign * quarter
                voxel = tuple(np.rint(candidate / VOXEL_SIZE).astype(int))
                tried += 1
                if labels[voxel] == k + 1:
                    moved[k] = candidate
                    inside += 1
            sets.append(moved)
    return sets, inside, tried


def stack(options: Options) -> Path:
    """The image; MissingData where it is not at hand."""
    path = options.data / "images" / "vesicles_GUV.tif"
    if not path.is_file():
        raise MissingData(f"no {path.name} at {path.parent}")
    return path


def vesicles(options: Options) -> list[Row]:
    """Distance to the membrane ridge, leaks, time, and the same from shifted centres."""
    path = stack(options)
    image = read_image(path)[0].astype(np.float32)
    points, _ = read_points_csv(CENTRES)
    found = fitted(path, VOXEL_SIZE, CENTRES)
    mesh = found.mesh
    rows = [at_most("vesicles, whole command", 60, found.seconds, "s", found.note)]
    rows += _ridge_rows(mesh, image, found.rendered)
    alarms = [w for w in found.report["warnings"] if "leaked" in w]
    rows.append(at_most("vesicles, leaks reported", 0, len(alarms), ""))
    sets, inside, tried = shifted(image, points)
    worst, note = 0.0, f"{inside} of {tried} moves stay inside their vesicle"
    for moved in sets[:1] if options.quick else sets:
        other = fitted(path, VOXEL_SIZE, moved).mesh
        for region in mesh.region_ids():
            one, two = mesh.region_surface(region), other.region_surface(region)
            worst = max(worst, surface_distance(one, two, samples=4000).mean / VOXEL_SIZE[1])
    what = "vesicles, centres moved by a quarter, mean distance"
    return [*rows, at_most(what, 0.2, worst, "voxel", note)]


def _ridge_rows(mesh: Mesh, image: np.ndarray, rendered: np.ndarray) -> list[Row]:
    """The distance to the ridge, and what of it the rendered image does not show as well."""
    rows = []
    regions = [r for r in mesh.region_ids() if r != 0]
    closed = sum(mesh.is_closed(r) for r in regions)
    rows.append(at_least("vesicles, closed surfaces", 3, closed, ""))
    for region in regions:
        surface = mesh.region_surface(region)
        measured = ridge_distance(surface, image, VOXEL_SIZE)
        beyond = measured.beyond(ridge_distance(surface, rendered, VOXEL_SIZE)).summary()
        found = measured.summary()
        note = (
            f"axial {found['axial_um'] * 1000:.0f} nm, "
            f"shift {found['lateral_shift_um'] * 1000:.0f} nm, "
            f"no ridge on {found['fraction_without_ridge']:.1%}"
        )
        rows.append(
            at_most(
                f"vesicle {region}, median lateral distance to the ridge",
                0.4,
                found["lateral_voxels"],
                "voxel",
                note,
            )
        )
        name = f"vesicle {region}, the same, less what the rendered image shows"
        note = (
            f"shift {beyond['lateral_shift_um'] * 1000:.0f} nm, "
            f"axial {beyond['axial_um'] * 1000:.0f} nm"
        )
        rows.append(Row(name, "", beyond["lateral_voxels"], "voxel", None, note))
    return rows


FIGURES: dict[str, Figure] = {"vesicles": vesicles}
