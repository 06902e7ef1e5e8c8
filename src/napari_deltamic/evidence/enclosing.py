"""Membranes that enclose a cell and belong to none, such as that of the cell around a nucleus.

Where labels are those of nuclei, a fit may end on their faint envelopes. The brighter membrane of
the cell around each is then light of other objects, by which nothing else judges the fit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from ..common.ball import ball_radius
from ..fitting.objective.deep_insides import Cells
from ..fitting.voxels.voxel_ownership import RULES as OWNERSHIP
from ..geometry.mesh import OUTSIDE
from ..scene import Grid
from .cell_voxels import voxels_at
from .left_out import noise_beside

_Array = NDArray[np.floating]
_Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class EnclosingRules:
    """What counts as a membrane around a cell; lengths in widths of the PSF, at least a voxel each.

    Lines go straight out from the surface of the cell, so that a membrane is blurred as much as the
    surface that it is compared with.

    Attributes
    ----------
    lines
        Lines of a cell, evenly over its surface; chosen, for a hundredth of it each.
    smooth
        Width of the blur before; as for light of other objects.
    own
        How far from the surface its own brightness is looked for: it may be off by so much. Chosen.
    gap
        Between which distances it must be darker than the surface. Chosen: there the light of the
        surface itself has faded to a quarter or less.
    bright
        Least brightness of the membrane over that of the surface on the same line. Chosen: as it
        is, no cell is enclosed by its likes.
    most
        Least share of the lines that cross the gap and then meet such a membrane. Measured: 0.8 to
        1 in seven nuclei whose envelopes are 0.07 to 0.8 times as bright as the membrane around
        them; below 0.3 in some 3000 other cells of 811 fits, one of them in an equally bright
        shell. Not more, as a nucleus may touch the membrane on one side.
    touches
        There it is so many times as bright at the surface as where lines meet one. Chosen.
    around
        Least share of the lines that meet it or where it touches. Measured: 0.85 or more in four
        nuclei, up to one that touches it; 0.6 in a membrane that is open on one side.
    reach
        Farthest from the surface, radii of the ball of the cell's volume: that of a cell four times
        as wide. Chosen.
    thick, falls
        How far beyond the brightest place light has faded, as that of a membrane but no haze has;
        and to which share of it. Chosen.
    """

    lines: int = 100
    smooth: float = OWNERSHIP.smooth
    own: float = 1.5
    gap: tuple[float, float] = (2.0, 3.0)
    bright: float = 1.0
    most: float = 0.5
    touches: float = 1.5
    around: float = 0.7
    reach: float = 3.0
    thick: float = OWNERSHIP.haze
    falls: float = 0.6


RULES = EnclosingRules()


def enclosing_membranes(cells: Cells, seen: _Array, background: float) -> dict[int, float]:
    """How many times as bright as its surface the membrane is that encloses each cell.

    Cells are left out that none encloses, or that of another cell.

    Parameters
    ----------
    seen
        (Z, Y, X) the measured image without what effects add, NaN where missing.
    background
        Background of the fit.
    """
    mesh, grid, known = cells.mesh, cells.grid, np.isfinite(seen)
    if not (beside := known & (cells.labels == OUTSIDE)).any():
        return {}
    size, sigma = np.asarray(grid.voxel_size), np.asarray(cells.optics.sigma_um)
    rest = np.where(known, seen - background, 0.0).astype(np.float32)
    light = gaussian_filter(rest, RULES.smooth * sigma / size)
    image = _Image(grid, light, cells.labels, known, noise_beside(light[beside]))
    areas, normals, volumes = mesh.areas(), mesh.normals(), mesh.volumes()
    middles = mesh.vertices_numpy()[mesh.faces].mean(1)
    found: dict[int, float] = {}
    for region, own in mesh.faces_by_region().items():
        faces = own[_evenly(areas[own])]
        out = np.where(mesh.regions[faces, :1] == region, 1.0, -1.0) * normals[faces]
        width = np.linalg.norm(out * np.maximum(sigma, size), axis=1)
        free = (mesh.regions[faces] == OUTSIDE).any(1) & (width > 0)
        lines = _Lines(middles[faces][free], out[free], width[free])
        reach = RULES.reach * float(ball_radius(abs(volumes[region])))
        # Few cells have a gap around most of them, for which to look is cheap.
        if np.count_nonzero(image.gaps(lines)) < RULES.most * len(faces):
            continue
        times, near = image.brightness(lines, reach)
        met = times > 0
        if np.count_nonzero(met) < RULES.most * len(faces):
            continue
        touches = ~met & (near > RULES.touches * np.median(near[met]))
        if np.count_nonzero(met | touches) >= RULES.around * len(faces):
            found[region] = float(np.median(times[met]))
    return found


def _evenly(areas: _Array) -> NDArray[np.signedinteger]:
    """Indices of faces at places evenly over their areas."""
    at = np.cumsum(areas)
    places = (np.arange(RULES.lines) + 0.5) / RULES.lines * at[-1]
    return np.searchsorted(at, places).clip(0, len(at) - 1)


@dataclass(frozen=True, eq=False)
class _Lines:
    """Lines out of a cell: (n, 3) um where they start, (n, 3) unit vectors, (n,) widths, um."""

    starts: _Array
    out: _Array
    width: _Array


@dataclass(frozen=True, eq=False)
class _Image:
    """(Z, Y, X) smoothed light, cells, and where the image is known; and what is above noise."""

    grid: Grid
    light: NDArray[np.float32]
    labels: NDArray[np.signedinteger]
    known: _Mask
    noise: float

    def gaps(self, lines: _Lines) -> _Mask:
        """(n,) whether it is darker some way out than where the line starts."""
        along, far = self._steps(lines, RULES.gap[1])
        light, _ = self._along(lines, along, far)
        return self._gaps(light, far)

    def brightness(self, lines: _Lines, reach: float) -> tuple[_Array, _Array]:
        """(n,) brightness of what each line meets within ``reach`` um, over that at its start.

        0 where it meets no membrane beyond a gap. Also (n,) how bright it is up to there.
        """
        along, far = self._steps(lines, RULES.thick, reach)
        light, ends = self._along(lines, along, far)
        own = self._own(light, far)
        seen = (far > RULES.gap[1]) & (along < ends[:, None])
        least = np.maximum(RULES.bright * own, self.noise)[:, None]
        bright = seen & (along <= reach) & (light >= least)
        first = along[bright.argmax(1)]
        thick = RULES.thick * lines.width
        wall = seen & (along >= first[:, None]) & (along <= (first + thick)[:, None])
        peak = np.where(wall, light, -np.inf)
        at = along[peak.argmax(1)]
        beyond = seen & (along >= at[:, None]) & (along <= (at + thick)[:, None])
        fallen = np.where(beyond, light, np.inf).min(1) < RULES.falls * peak.max(1)
        met = self._gaps(light, far) & bright.any(1) & fallen
        near = np.where(np.abs(far) <= RULES.gap[1], light, -np.inf).max(1)
        return np.where(met, peak.max(1) / np.maximum(own, 1e-30), 0.0), near

    def _steps(self, lines: _Lines, widths: float, reach: float = 0.0) -> tuple[_Array, _Array]:
        """(m,) um along all lines, from within to some widths beyond a reach; (n, m) widths."""
        step, widest = min(self.grid.voxel_size), lines.width.max(initial=0.0)
        first, last = -RULES.own * widest, reach + widths * widest
        along = np.arange(np.floor(first / step), np.ceil(last / step) + 1) * step
        return along, along / lines.width[:, None]

    def _own(self, light: _Array, far: _Array) -> _Array:
        found: _Array = np.where(np.abs(far) <= RULES.own, light, -np.inf).max(1)
        return found

    def _gaps(self, light: _Array, far: _Array) -> _Mask:
        gap = (far >= RULES.gap[0]) & (far <= RULES.gap[1])
        return np.asarray(np.where(gap, light, -np.inf).max(1) < self._own(light, far))

    def _along(
        self, lines: _Lines, along: _Array, far: _Array
    ) -> tuple[NDArray[np.float32], _Array]:
        """(n, m) light along lines, and (n,) um where each leaves the image or nears a cell."""
        places = lines.starts[:, None] + along[:, None] * lines.out[:, None]
        index = voxels_at(places, self.grid)
        inside = ((index >= 0) & (index < np.asarray(self.grid.shape))).all(-1)
        at = tuple(np.moveaxis(index.clip(0, np.asarray(self.grid.shape) - 1), -1, 0))
        lost = (along > 0) & ~(inside & self.known[at])
        cell = inside & (self.labels[at] != OUTSIDE) & (far > RULES.own)
        # What shines just before another cell is its membrane.
        near = np.where(cell.any(1), along[cell.argmax(1)] - RULES.gap[1] * lines.width, np.inf)
        ends = np.where(lost.any(1), along[lost.argmax(1)], np.inf)
        return self.light[at], np.minimum(near, ends)
