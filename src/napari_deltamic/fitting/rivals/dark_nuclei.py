"""Cytoplasm around dark nuclei, which a fit of both has taken for membranes around dim insides.

A bright layer a few widths of the PSF thick looks like a membrane seen through a wider PSF, and a
fit of both ends in the middle of it. What is left does not tell them apart: grain in the cytoplasm
is explained by a membrane of uneven brightness. How thick the layer is does. So where a fit of both
ends, insides with a second surface within, that of a nucleus, are followed from both sides of its
surface. Around a membrane, the two come together; around a nucleus, they stay apart.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from statistics import median

import numpy as np
import torch
from numpy.typing import NDArray
from skimage.segmentation import find_boundaries

from ...common.triple import geometric_mean
from ...errors import InputError, RepairWarning
from ...geometry.distance_transform import distance_transform, nearest_outside
from ...geometry.labels.meshes import mesh_from_labels
from ...geometry.labels.voxels import voxel_labels
from ...geometry.mesh import FloatArray, Mesh, mesh_of_faces
from ...optics import GaussianMixturePSF, GaussianPSF
from ...scene import Grid
from ...scene.light import INSIDES, Light
from ..model.fitted import Fitted
from ..model.level import Level
from ..model.shape import Shape
from ..objective.fit_objective import Objective, Terms
from ..objective.prediction import as_floats
from ..solvers.preconditioner import Preconditioners
from .gains import gains_over
from .rival_structures import RULES as RIVALS
from .rival_structures import begun, descend_and_pose_anew, gains_exceed_error

# Of the brightest, below which nothing is dimmed; chosen: about the error of the rendering.
_FAINT = 1e-3


@dataclass(frozen=True)
class DarkNucleiRules:
    """When a layer is cytoplasm.

    Attributes
    ----------
    apart
        Widths of the PSF between two borders that are seen as two: by definition (Sparrow's
        criterion for two Gaussians).
    begin
        Widths of the PSF that they are apart where they begin: the full width of a Gaussian at half
        of its maximum. Measured on ten cells and crowds of cytoplasm (benchmarks.defaults): from 3,
        or from further in, others are found, and no more.
    fewest
        Voxels of a nucleus, below which a cell has none; chosen: 3 x 3 x 3.
    legs, growing
        How often, at most, insides around nuclei are followed as far again, and the share by which
        what they explain must grow each time; chosen, as for hidden membranes.
    most
        Share of a cell that its nucleus may be, of all cells together; chosen: few nuclei are
        larger. Measured: 0.12 to 0.30 in cells of cytoplasm; 0.48 in a membrane seen by a widefield
        microscope, whose layer had stayed 2.4 widths thick and would have ended 1.2 voxels off.
    dark
        Of the cytoplasm, how bright nuclei are at most, in the median. Chosen; measured: -0.2 to
        0.31 in cells of cytoplasm; 0.62 and 0.87 in two small cells with membranes and bright
        insides, whose layers had stayed 2.2 widths thick and would have ended 40 % too large.
    thinner
        Share by which the layer must get thinner each time, while it does: where that ends, it is
        as thick as it is. Measured around membranes: 0.12 and more each time, down to one width.
    lost
        Errors of sums over blocks by which they explain less, at which they are given up, with
        insides evened and as measured. Measured after twelve steps with the PSF fitted, of the
        better of both: 5.3 to -3.3 in nine cells of cytoplasm, -1.8 to -9.1 in 19 fits of membranes
        and insides.
    darkest
        Of the cytoplasm, the least that is left of it anywhere: chosen, as what is measured there
        is divided by it.
    """

    apart: float = 2.0
    begin: float = 2.355
    fewest: int = 27
    legs: int = 10
    growing: float = 0.05
    most: float = 0.4
    dark: float = 0.5
    thinner: float = 0.05
    lost: float = 4.5
    darkest: float = 0.1


RULES = DarkNucleiRules()


@dataclass(frozen=True, eq=False)
class _Cells:
    """Cells with a nucleus each, but for small ones; a nucleus is a region of its own.

    Attributes
    ----------
    mesh
        Of both.
    nuclei
        The region of each cell's nucleus.
    """

    mesh: Mesh
    nuclei: Mapping[int, int]

    def thickness(self, mesh: Mesh) -> float:
        """um, in the mean: volume of cytoplasm around nuclei over the area of its middle."""
        volumes, areas, regions = mesh.volumes(), mesh.areas(), mesh.regions
        inner = np.isin(regions, list(self.nuclei.values())).any(axis=1)
        both = inner | np.isin(regions, list(self.nuclei)).any(axis=1)
        layer = sum(volumes[cell] for cell in self.nuclei)
        return 2 * layer / max(float(areas[both].sum()), 1e-300)

    def patches(self, mesh: Mesh, width: float) -> float:
        """How many patches twice as wide as the PSF (um) the surfaces of nuclei have."""
        areas, nuclei = mesh.areas(), list(self.nuclei.values())
        inner = np.isin(mesh.regions, nuclei).any(axis=1)
        return float(areas[inner].sum()) / (2 * width) ** 2

    def share(self, mesh: Mesh) -> float:
        """Share of the volume of cells with a nucleus that their nuclei fill."""
        volumes = mesh.volumes()
        held, around = (
            sum(volumes[k] for k in regions) for regions in (self.nuclei.values(), self.nuclei)
        )
        return held / max(held + around, 1e-300)

    def brightness(self, light: Light) -> float:
        """Brightness of nuclei over that of the cytoplasm around them, in the median."""
        known = dict(light.cells)
        cells = ((known.get(n, 1.0), known.get(cell, 1.0)) for cell, n in self.nuclei.items())
        return median(inner / max(around, 1e-300) for inner, around in cells)

    def outer(self, mesh: Mesh) -> Mesh:
        """The cells alone, with what their nuclei hold."""
        regions = self._cells_of(mesh.regions)
        kept = regions[:, 0] != regions[:, 1]
        return mesh_of_faces(mesh.vertices_numpy(), mesh.faces[kept], regions[kept])[0]

    def filled(self, light: Light) -> Light:
        """The light if nuclei were as bright as the cytoplasm around them."""
        known = dict(light.cells)
        cells = {k: known.get(int(self._cells_of(np.array(k))), 1.0) for k in known}
        return replace(light, cells=tuple(cells.items()))

    def without_nuclei(self, light: Light) -> Light:
        """The light of the cells alone."""
        nuclei = set(self.nuclei.values())
        cells = tuple(cell for cell in light.cells if cell[0] not in nuclei)
        return replace(light, cells=cells if len(cells) > 1 else ())

    def _cells_of(self, regions: NDArray[np.signedinteger]) -> NDArray[np.signedinteger]:
        found = regions.copy()
        for cell, nucleus in self.nuclei.items():
            found[regions == nucleus] = cell
        return found


def around_nuclei(terms: Terms, objective: Objective) -> tuple[Fitted | None, bool, int]:
    """The fit of insides around dark nuclei, if a fit of both is one; and evaluations.

    Also, if it is none, whether it may be one: there is a layer, which both explain better, or as
    well. Asked through Gaussian PSFs: what light cones add to a layer has no width.
    """
    fitted = objective.fitted
    asked = terms.second is None and terms.settings.density != "uniform"
    asked = asked and isinstance(fitted.optics, GaussianPSF | GaussianMixturePSF)
    if not asked or objective.now.light.interior <= 0 or fitted.shape.pinned.any():
        return None, False, 0
    width = geometric_mean(fitted.first_optics.sigma_um)
    cells = _with_nuclei(fitted.mesh, terms.level.grid, RULES.begin / 2 * width)
    if cells is None:
        return None, False, 0
    both = objective.anew()
    rival, may, taken = _followed(terms, both, cells)
    taken += both.evaluations()
    if not may:
        return None, False, taken
    gains = gains_over(rival, both)
    # While the PSF is held, a layer stands in for one that is wider.
    doubted = not terms.settings.fit_psf
    # A number that means nothing gains half a nat, and costs as much in other images (H. Akaike,
    # 1973); a second surface has one for each patch.
    width = geometric_mean(rival.fitted.optics.sigma_um)
    doubted |= float(gains[1].sum()) < cells.patches(rival.fitted.mesh, width)
    if doubted or any(gains_exceed_error([-gain], RIVALS.errors) for gain in gains):
        return None, True, taken
    return _alone(terms.level, rival, cells), False, taken


def _followed(terms: Terms, both: Objective, cells: _Cells) -> tuple[Objective, bool, int]:
    """Insides around nuclei, followed while they gain on both; whether the layer stays thick."""
    fitted, mesh = both.fitted, cells.mesh
    begin = fitted.retriangulated(Shape.begun(mesh, fitted.shape.model)).shining(INSIDES)
    begin = begin.displaced(mesh.vertices_numpy(), fitted.first_optics).with_structure("interior")
    rival, taken = descend_and_pose_anew(begun(terms, begin, Preconditioners()))
    thick, least = np.inf, -np.inf
    for _ in range(RULES.legs):
        before, thick = thick, _thickness(rival, cells)
        gains = gains_over(rival, both)
        lost = all(gains_exceed_error([-gain], RULES.lost) for gain in gains)
        # The PSF may widen before surfaces move: then the layer looks thin, but gets thicker.
        if lost or (thick < RULES.apart and thick <= before < np.inf):
            return rival, False, taken
        reached, least = least, min(float(gain.sum()) for gain in gains)
        sure = all(gains_exceed_error([gain], RIVALS.errors) for gain in gains)
        grows = least - reached > RULES.growing * abs(least) and not sure
        if before - thick < RULES.thinner * thick and not grows:
            break
        rival, more = descend_and_pose_anew(rival)
        taken += more
    layer = _thickness(rival, cells) > RULES.apart
    small = cells.share(rival.fitted.mesh) < RULES.most
    return rival, layer and small and cells.brightness(rival.now.light) < RULES.dark, taken


def _thickness(rival: Objective, cells: _Cells) -> float:
    """Widths of the PSF that the two borders of the cytoplasm are apart."""
    width = geometric_mean(rival.fitted.optics.sigma_um)
    return cells.thickness(rival.fitted.mesh) / width


def _with_nuclei(mesh: Mesh, grid: Grid, away: float) -> _Cells | None:
    """Borders about so far out (um), and nuclei so far in; None if no cell is large enough for one.

    Made of voxels: nuclei lie up to one further in, borders up to half of one less far out.
    """
    size = np.asarray(grid.voxel_size)
    low, high = mesh.bounds() - np.asarray(grid.origin)
    start = np.floor((low - away) / size).astype(int) - 2
    shape = tuple((np.ceil((high + away) / size).astype(int) + 3 - start).tolist())
    origin = tuple((np.asarray(grid.origin) + start * size).tolist())
    names = mesh.region_ids()
    known = voxel_labels(mesh, shape, grid.voxel_size, origin)
    labels = np.searchsorted(np.append(0, names), known)  # names may be large numbers
    depth = distance_transform(~find_boundaries(labels, mode="inner"), size)
    outside, nearest = nearest_outside(labels == 0, size)
    found = np.where(outside < away, np.take(labels, nearest), 0)
    cells, last = range(1, len(names) + 1), len(names)
    table = names.tolist()
    nuclei = dict[int, int]()
    for cell in cells:
        nucleus = (labels == cell) & (depth > away)
        if nucleus.sum() >= RULES.fewest:
            last += 1
            nuclei[cell] = last
            found[nucleus] = last
            table.append(int(names.max()) + last - len(names))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RepairWarning)
            both = mesh_from_labels(found, grid.voxel_size, origin)
    except InputError:  # all of them are too small for a mesh
        return None
    kept = set(both.region_ids().tolist())
    regions = {table[k - 1]: table[n - 1] for k, n in nuclei.items() if n in kept}
    if not regions or not kept.issuperset(cells):
        return None
    numbers = np.append(0, np.asarray(table, np.int64))
    return _Cells(Mesh(both.vertices_numpy(), both.faces, numbers[both.regions]), regions)


def _alone(level: Level, rival: Objective, cells: _Cells) -> Fitted:
    """The fit of cells without their nuclei, which dim what insides show."""
    fitted, light = rival.fitted, rival.now.light
    one, even = (_shown(level, fitted, shone) for shone in (light, cells.filled(light)))
    shines = even > _FAINT * float(even.max())
    dimmed = np.ones(even.shape, np.float32)
    dimmed[shines] = np.clip(one[shines] / even[shines], RULES.darkest, 1.0)
    mesh = cells.outer(fitted.mesh)
    outer = fitted.retriangulated(Shape.begun(mesh, fitted.shape.model))
    return outer.shining(cells.without_nuclei(light)).with_nuclei(dimmed)


def _shown(level: Level, fitted: Fitted, light: Light) -> FloatArray:
    """(Z, Y, X) of what is fitted, of amplitude 1."""
    renderer = level.renderer(fitted.mesh, fitted.optics, fitted.effects, insides=True)
    with torch.no_grad():
        spectrum = renderer.transform(light=light)
        return as_floats(level.rendered(renderer, spectrum, renderer.otf(fitted.optics)))
