"""Images of meshes by a way of their own: voxels three times finer, blurred, binned.

Nothing here is shared with the renderer that is judged: surfaces are points put into fine voxels,
insides are counted crossings, the blur is a sum in real space, and binning folds light beyond the
Nyquist limit as a camera does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import affine_transform, gaussian_filter
from scipy.signal import fftconvolve

from napari_deltamic import Mesh

Array = NDArray[np.float64]
FINE = 3  # fine voxels along a voxel
_PER_VOXEL = 3.0  # points of a surface that fall into a fine voxel that it crosses
APERTURE, WATER = 1.2, 1.33  # of the microscopes
# Standard deviation in the plane, in wavelengths / NA.
_ACROSS = {"widefield": 0.22, "sheet": 0.22, "confocal": 0.216}
_SHEET = 3.0  # standard deviation of a light sheet, of that of the PSF in the plane
_PINHOLE = 0.61  # radius, wavelengths / NA: one Airy unit across


@dataclass(frozen=True)
class Field:
    """Fine voxels around a stack: its shape, voxel size (um) and a rim, voxels wide.

    The centre of the stack's first voxel lies at 0, as everywhere.
    """

    shape: tuple[int, int, int]
    voxel: tuple[float, float, float]
    rim: int = 8

    @property
    def fine_shape(self) -> tuple[int, ...]:
        return tuple(FINE * (n + 2 * self.rim) for n in self.shape)

    @property
    def fine_size(self) -> Array:
        return np.asarray(self.voxel) / FINE

    def fine_position(self, points: Array) -> Array:
        """Continuous indices of fine voxels; whole numbers are centres."""
        return points / self.fine_size + FINE * self.rim + (FINE - 1) / 2

    def binned(self, fine: Array) -> Array:
        """Means over the voxels of the stack, without the rim."""
        n = np.asarray(self.shape) + 2 * self.rim
        blocks = fine.reshape(n[0], FINE, n[1], FINE, n[2], FINE).mean((1, 3, 5))
        keep = tuple(slice(self.rim, self.rim + k) for k in self.shape)
        result: Array = blocks[keep]
        return result


def surface_points(mesh: Mesh, spacing: float, rng: np.random.Generator) -> tuple[Array, ...]:
    """Points on the faces, about so far apart: positions, face of each, area of each (um^2)."""
    areas = mesh.areas()
    count = np.maximum(1, np.ceil(areas / spacing**2)).astype(int)
    face = np.repeat(np.arange(len(areas)), count)
    a, b = rng.random((2, len(face)))
    over = a + b > 1
    a[over], b[over] = 1 - a[over], 1 - b[over]
    corners = mesh.vertices_numpy()[mesh.faces][face]
    points = corners[:, 0] + a[:, None] * (corners[:, 1] - corners[:, 0])
    points = points + b[:, None] * (corners[:, 2] - corners[:, 0])
    return points, face, (areas / count)[face]


def surface_light(
    mesh: Mesh,
    field: Field,
    rng: np.random.Generator,
    density: Callable[[Array], Array] | None = None,
    thickness: float = 0.0,
) -> Array:
    """Fine voxels lit by the membranes; a wall between two cells is two of them.

    thickness : um; light is spread evenly along the normal over this length.
    """
    spacing = float(field.fine_size.min()) / _PER_VOXEL**0.5
    points, face, area = surface_points(mesh, spacing, rng)
    weight = area * np.where((mesh.regions[face] > 0).all(1), 2.0, 1.0)
    if density is not None:
        weight = weight * density(points)
    if thickness > 0:
        layers = int(np.ceil(2 * thickness / float(field.fine_size.min())))
        normals = mesh.normals()[face]
        light = np.zeros(field.fine_shape)
        for layer in range(layers):
            offset = ((layer + rng.random(len(points))) / layers - 0.5) * thickness
            light += _deposited(points + offset[:, None] * normals, weight / layers, field)
        return light
    return _deposited(points, weight, field)


def _deposited(points: Array, weight: Array, field: Field) -> Array:
    index = np.rint(field.fine_position(points)).astype(np.int64)
    shape = np.asarray(field.fine_shape)
    inside = ((index >= 0) & (index < shape)).all(1)
    flat = np.ravel_multi_index(tuple(index[inside].T), field.fine_shape)
    found = np.bincount(flat, weight[inside], int(shape.prod()))
    return np.asarray(found.reshape(field.fine_shape) / float(np.prod(field.fine_size)))


def inside(
    mesh: Mesh, region: int, shape: tuple[int, ...], place: Callable[[Array], Array]
) -> Array:
    """1 in the voxels whose centre lies in a region, 0 elsewhere, by crossings along Z.

    place : from um to continuous indices of these voxels.
    """
    faces, sides = mesh.faces, mesh.regions
    own = (sides == region).any(1)
    sign = np.where(sides[own, 0] == region, 1.0, -1.0)  # normals point from the first
    corners = place(mesh.vertices_numpy().reshape(-1, 3))[faces[own]]
    corners = corners + np.array([0.0, 1.234e-5, 2.345e-5])  # no column meets an edge
    crossings = np.zeros((shape[0] + 1, *shape[1:]))
    low = np.ceil(corners[:, :, 1:].min(1)).astype(int)
    high = np.floor(corners[:, :, 1:].max(1)).astype(int)
    extent = np.maximum(high - low + 1, 0)
    for dy in range(int(extent[:, 0].max(initial=0))):
        for dx in range(int(extent[:, 1].max(initial=0))):
            some = (dy < extent[:, 0]) & (dx < extent[:, 1])
            y, x = low[some, 0] + dy, low[some, 1] + dx
            z, hit, turn = _height(corners[some], y, x)
            hit &= (y >= 0) & (y < shape[1]) & (x >= 0) & (x < shape[2])
            first = np.clip(np.ceil(z[hit]), 0, shape[0]).astype(int)
            np.add.at(crossings, (first, y[hit], x[hit]), (turn * sign[some])[hit])
    return np.asarray(np.abs(np.rint(np.cumsum(crossings[:-1], 0))) > 0.5, float)


def _height(corners: Array, y: Array, x: Array) -> tuple[Array, NDArray[np.bool_], Array]:
    """Where the column (y, x) meets each triangle: Z, whether it does, which way it faces."""
    a, b, c = (corners[:, k] for k in range(3))
    area = (b[:, 1] - a[:, 1]) * (c[:, 2] - a[:, 2]) - (b[:, 2] - a[:, 2]) * (c[:, 1] - a[:, 1])
    flat = area == 0
    safe = np.where(flat, 1.0, area)
    v = ((y - a[:, 1]) * (c[:, 2] - a[:, 2]) - (x - a[:, 2]) * (c[:, 1] - a[:, 1])) / safe
    w = ((b[:, 1] - a[:, 1]) * (x - a[:, 2]) - (b[:, 2] - a[:, 2]) * (y - a[:, 1])) / safe
    hit = ~flat & (v >= 0) & (w >= 0) & (v + w < 1)
    z = a[:, 0] + v * (b[:, 0] - a[:, 0]) + w * (c[:, 0] - a[:, 0])
    return z, hit, np.sign(area)


def imaged(light: Array, field: Field, sigma: tuple[float, float, float]) -> Array:
    """The stack without noise: blurred by a Gaussian (um, Z Y X) and binned."""
    width = np.asarray(sigma) / field.fine_size
    return field.binned(gaussian_filter(light, width, mode="constant", truncate=5.0))


def wavelength(microscope: str, across: float) -> float:
    """um; with which a microscope's PSF has a standard deviation across, um, in the plane."""
    return across * APERTURE / _ACROSS[microscope]


def seen_by(
    microscope: str,
    light: Array,
    field: Field,
    across: float,
    aberrated: float = 0.0,
    leaning: float = 0.0,
) -> Array:
    """The stack without noise, by a microscope; see :func:`point_spread`."""
    point = point_spread(microscope, field, across, aberrated, leaning)
    return np.maximum(field.binned(fftconvolve(light, point, "same")), 0)


def point_spread(
    microscope: str, field: Field, across: float, aberrated: float = 0.0, leaning: float = 0.0
) -> Array:
    """The PSF on fine voxels, of unit sum, of a microscope, as wide in the plane (um) as asked.

    Its field is summed over the pupil plane by plane (scalar theory); of a confocal one, light that
    excites has the wavelength of that which is detected.

    aberrated : rad, root mean square over the pupil, of primary spherical aberration.
    leaning : degrees from Z towards X, of the axis of the objective, as in a deskewed stack.
    """
    wave = wavelength(microscope, across)
    depth, *plane = (n // 2 * 2 + 1 for n in field.fine_shape)
    ky, kx = (np.fft.fftfreq(n, d) for n, d in zip(plane, field.fine_size[1:], strict=True))
    squared = ky[:, None] ** 2 + kx**2
    radius = squared / (APERTURE / wave) ** 2  # squared, 1 at the rim of the pupil
    zernike = np.sqrt(5) * (6 * radius**2 - 6 * radius + 1)
    pupil = (radius <= 1) * np.exp(1j * aberrated * zernike)
    along = np.sqrt(np.maximum((WATER / wave) ** 2 - squared, 0))
    focus = (np.arange(depth) - depth // 2) * field.fine_size[0]
    waves = (np.fft.ifft2(pupil * np.exp(2j * np.pi * z * along)) for z in focus)
    point = np.fft.fftshift(np.stack([np.abs(wave) ** 2 for wave in waves]), axes=(1, 2))
    if microscope == "confocal":
        y, x = (
            (np.arange(n) - n // 2) * d for n, d in zip(plane, field.fine_size[1:], strict=True)
        )
        pinhole = (y[:, None] ** 2 + x**2 <= (_PINHOLE * wave / APERTURE) ** 2).astype(float)
        point = point * np.stack([fftconvolve(one, pinhole, "same") for one in point])
    if microscope == "sheet":
        point *= np.exp(-0.5 * (focus / (_SHEET * across)) ** 2)[:, None, None]
    if leaning:
        point = _turned(point, field, np.deg2rad(leaning))
    # Aberrations move the focus: where it is, is where the stage says.
    brightest = int(point.max((1, 2)).argmax())
    result: Array = np.roll(point, depth // 2 - brightest, 0) / point.sum()
    return result


def _turned(point: Array, field: Field, angle: float) -> Array:
    """A PSF whose axis leans by an angle (rad) from Z towards X."""
    c, s = np.cos(angle), np.sin(angle)
    back = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])  # from there to where it stood upright
    step = back * field.fine_size / field.fine_size[:, None]
    middle = np.asarray(point.shape) // 2
    return np.maximum(affine_transform(point, step, middle - step @ middle, order=3), 0)


def effective_sigma(field: Field, sigma: tuple[float, float, float]) -> tuple[float, ...]:
    """um; the Gaussian with the variance of blur, voxels and fine voxels together."""
    size = np.asarray(field.voxel)
    return tuple(np.sqrt(np.asarray(sigma) ** 2 + size**2 / 12 * (1 + FINE**-2)).tolist())


def counted_photons(
    clean: Array, photons: float, dark: float, rng: np.random.Generator
) -> NDArray[np.float32]:
    """A stack with so many photons at its brightest, on a background of so many."""
    peak = float(np.percentile(clean, 99.8)) or float(clean.max())
    return rng.poisson(photons * clean / peak + dark).astype(np.float32)
