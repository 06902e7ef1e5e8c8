"""How far a mesh lies from the bright crest of the membrane in an image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from napari_deltamic.errors import InputError
from napari_deltamic.geometry.labels.basins import pixel_noise
from napari_deltamic.geometry.mesh import Mesh

STEPS_PER_VOXEL = 4  # of a profile: narrower than any ridge could be
ROUNDING = 1e-6  # of the image's range: errors of that size on smooth slopes would be peaks
LATERAL_LIMIT = 0.5  # |normal along Z| below this: the profile runs mostly within planes
REACH = 0.8  # um to either side: further away could be the membrane of a neighbour
CONTRAST = 0.3  # of a profile's range: less is only a bump on the flank of another peak
NOISE_LIMIT = 4.0  # standard deviations: hardly a profile of noise has such a peak


@dataclass(frozen=True)
class RidgeDistance:
    """Offsets of the membrane ridge from the faces of a mesh, see `ridge_distance`.

    offset : (F,) um along the normal, positive where the ridge lies on the side the normal points
        to; nan where the profile has no clear ridge or leaves the image.
    lateral : (F,) bool, True where the normal lies mostly within the image planes.
    lateral_voxel, axial_voxel : um, voxel sides within planes (mean of Y, X) and along Z.
    """

    offset: NDArray[np.float64]
    lateral: NDArray[np.bool_]
    lateral_voxel: float
    axial_voxel: float

    @property
    def found(self) -> NDArray[np.bool_]:
        """(F,) bool, True where there is a ridge."""
        return np.isfinite(self.offset)

    def beyond(self, own: RidgeDistance) -> RidgeDistance:
        """Offsets less those of the mesh in its own rendered image; nan where one has no ridge.

        The ridge of a blurred membrane is not where the membrane is (see `ridge_distance`). In the
        image rendered of a mesh it is off by the same, as far as its PSF is right: what remains is
        how far the mesh lies from where it would explain the measured ridge.

        Parameters
        ----------
        own : distances of the same mesh, measured in its rendered image.

        Raises
        ------
        InputError
            They are of another number of faces.
        """
        if own.offset.shape != self.offset.shape:
            raise InputError("the two ridges must be those of one mesh")
        return replace(self, offset=self.offset - own.offset)

    def summary(self) -> dict[str, float]:
        """Medians over faces with a ridge (nan without any), counts, and the share without.

        `*_um` and `*_voxels` are of the absolute distance (voxels: lateral or axial ones),
        `*_shift_um` of the signed one, which tells a mesh that is too small (positive).
        """
        result: dict[str, float] = {}
        groups = (
            ("lateral", self.lateral, self.lateral_voxel),
            ("axial", ~self.lateral, self.axial_voxel),
        )
        for name, group, voxel in groups:
            values = self.offset[group & self.found]
            median = float(np.median(np.abs(values))) if len(values) else float("nan")
            result[f"{name}_um"] = median
            result[f"{name}_voxels"] = median / voxel
            result[f"{name}_shift_um"] = float(np.median(values)) if len(values) else float("nan")
            result[f"{name}_count"] = len(values)
        result["fraction_without_ridge"] = float(1 - self.found.mean())
        return result


def ridge_distance(
    mesh: Mesh,
    image: ArrayLike,
    voxel_size: Sequence[float],
    origin: Sequence[float] = (0.0, 0.0, 0.0),
    reach_um: float = REACH,
) -> RidgeDistance:
    """Find the membrane along the normal of each face, to a fraction of a voxel.

    The image is sampled (cubic splines) on lines along the normal of each face, about two voxels
    apart. Their mean is smoothed along the normal by half a voxel. Of its peaks that stand out by
    0.3 of its range, and by 4 standard deviations of the noise, the one nearest to the face is the
    ridge; a parabola through its top gives the offset. Faces whose lines leave the
    image are left out.

    The maximum of an image is not quite where the membrane is: a blurred shell of radius R peaks
    inside by about sigma^2 / R, where the sigma of a tall PSF counts even at upright walls, and a
    slope of haze pulls it further. `RidgeDistance.beyond` takes off what a rendered image of the
    mesh shows of this.

    Parameters
    ----------
    mesh : any mesh, um.
    image : (Z, Y, X), membranes bright.
    voxel_size, origin : um, Z, Y, X; origin is the centre of the first voxel.
    reach_um : um, how far to look on each side.

    Raises
    ------
    InputError
        The image is not a finite 3D array, or a size is not positive.
    """
    data = np.asarray(image, np.float64)
    size, start = np.asarray(voxel_size, np.float64), np.asarray(origin, np.float64)
    if data.ndim != 3 or not np.isfinite(data).all():
        raise InputError("the image must be a 3D array of finite numbers")
    if size.shape != (3,) or not (size > 0).all() or not reach_um > 0:
        raise InputError("voxel size (Z, Y, X) and reach must be positive, in um")
    step = float(size.min()) / STEPS_PER_VOXEL
    half = int(np.ceil(reach_um / step))
    ticks = np.arange(-half, half + 1) * step
    normals = mesh.normals()
    centres = mesh.vertices_numpy()[mesh.faces].mean(axis=1)
    spots = _spots(mesh, float(size.min()))
    shifts = mesh.vertices_numpy()[mesh.faces].swapaxes(1, 2) @ spots.T - centres[..., None]
    places = (centres[:, None] + ticks[:, None] * normals[:, None] - start) / size
    # The lines of a face reach as far as its corners.
    room = np.abs(shifts).max(axis=2)[:, None] / size
    last = np.array(data.shape) - 0.5
    within = ((places - room >= -0.5) & (places + room <= last)).all(axis=(1, 2))
    sigma = 0.5 * float(size.min())
    splines = ndimage.spline_filter(data, mode="nearest")
    profiles = np.zeros((int(within.sum()), len(ticks)))
    for k in range(len(spots)):
        line = places[within] + (shifts[within, :, k] / size)[:, None]
        values = ndimage.map_coordinates(
            splines, line.reshape(-1, 3).T, mode="nearest", prefilter=False
        )
        profiles += values.reshape(profiles.shape) / len(spots)
    profiles = ndimage.gaussian_filter1d(profiles, sigma / step, axis=1, mode="nearest")
    offset = np.full(len(normals), np.nan)
    least = (
        NOISE_LIMIT * pixel_noise(data) / len(spots) ** 0.5
        + ROUNDING * float(np.ptp(data))
        + 1e-300
    )
    offset[within] = [step * (_nearest_peak(p, least) - half) for p in profiles]
    lateral = np.abs(normals[:, 0]) < LATERAL_LIMIT
    return RidgeDistance(offset, lateral, float(size[1:].mean()), float(size[0]))


def _spots(mesh: Mesh, voxel: float) -> NDArray[np.float64]:
    """(n, 3) where the lines of a face start: barycentric, evenly over it.

    One for each part of about two voxels of a typical face.
    """
    n = int(np.clip(round(mesh.median_edge() / (2 * voxel)), 1, 3))
    i, j = (k.ravel() for k in np.mgrid[0:n, 0:n])
    upward = np.stack([i, j, n - 1 - i - j], 1)[i + j < n] + 1 / 3
    downward = np.stack([i, j, n - 2 - i - j], 1)[i + j < n - 1] + 2 / 3
    return np.concatenate([upward, downward]) / n


def _nearest_peak(profile: NDArray[np.float64], least: float) -> float:
    """Position, in samples, of the clear peak nearest to the middle; nan if there is none."""
    from scipy.signal import find_peaks  # loads for a third of a second, and few fits ask for it

    peaks, _ = find_peaks(profile, prominence=max(least, CONTRAST * float(np.ptp(profile))))
    if not len(peaks):
        return float("nan")
    top = int(peaks[np.abs(peaks - len(profile) // 2).argmin()])
    left, middle, right = profile[top - 1 : top + 2]
    bend = left - 2 * middle + right
    return top + (0.5 * float((left - right) / bend) if bend < 0 else 0.0)
