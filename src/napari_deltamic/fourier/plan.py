"""Plans: band, method and quadrature rules for an accuracy, with expected error and time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from math import floor, log, log2, pi, sqrt
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from ..common.accuracy_bounds import check_accuracy
from ..common.kept import kept
from ..errors import InputError
from .band import Band
from .closed_form import band_ft
from .cost import Work, built_in, count_work
from .falloff import Falloff, band_error, of_solid, of_surface, threshold_for
from .particle_mesh import elements_ft
from .points import Points
from .quadrature import Rule, choose_rules
from .spreading import Spreading, Transfer, choose_spreading, gaussian

Method = Literal["closed form", "particle-mesh"]
# From error and falloff (see :func:`band_error`) to half axes of the band (rad/um) and the largest
# |OTF| outside it.
Cutoff = Callable[[float, Falloff], tuple[tuple[float, float, float], float]]
METHODS: tuple[Method, ...] = ("closed form", "particle-mesh")

# Shares of the accuracy: the errors of band, quadrature and aliases are independent and add in
# squares, so that together they use 97 % of it at most.
_BAND_SHARE, RULE_SHARE, _ALIAS_SHARE = 0.7, 0.6, 0.3
# Factor on the shares of the other two if the grid itself ends the band, so that nothing is cut.
_WHOLE = sqrt(1 + _BAND_SHARE**2 / (RULE_SHARE**2 + _ALIAS_SHARE**2))
_FLAT = 0.1  # |OTF| at the edge of a band that no Gaussian describes: a flat one, to be safe
# Below this accuracy rounding in single precision would show.
_SINGLE_ABOVE = 3e-5
# Below this one rounding in double precision shows, and only the closed form everywhere is left.
EXACT_BELOW = 1e-13


@dataclass(frozen=True, eq=False)
class Plan:
    """How u_hat is computed on a band.

    Attributes
    ----------
    method
        ``"closed form"`` or ``"particle-mesh"``.
    accuracy
        Requested relative L2 error of the rendered image; 0 for the closed form at all wavevectors.
    expected_error
        Expected relative L2 error of a rendering.
    spreading
        Grid and kernels of the particle-mesh; None for the closed form.
    work
        Amounts of work of one rendering.
    device
        Type of the device for which it is made.
    """

    method: Method
    band: Band
    accuracy: float
    threshold: float
    single: bool
    spreading: Spreading | None
    rules: list[tuple[Rule, np.ndarray]] = field(repr=False)
    expected_error: float
    work: Work
    device: str = "cpu"

    @property
    def tolerance(self) -> float:
        """Relative L2 error that aliases may cause; 0 for the closed form."""
        return 0.0 if self.spreading is None else self.spreading.error

    @property
    def points(self) -> int:
        """Number of quadrature points; 0 for the closed form."""
        return sum(len(r.weights) * len(f) for r, f in self.rules)

    def transform(
        self,
        vertices: Tensor,
        faces: Tensor,
        density: Tensor,
        device: torch.device | None = None,
    ) -> Tensor:
        """Return u_hat on the box of the band, differentiable in vertices and density.

        Parameters
        ----------
        vertices
            (V, 3) um relative to the centre of the grid's first voxel.
        faces, density
            (F, 3) int64; (F,) fluorophores per um^2.
        device
            Where the result is to be; by default where the vertices are.

        Raises
        ------
        ValueError
            If a vertex is not finite, or a face names a vertex that is not there.
        """
        there = vertices.device if device is None else device
        if self.spreading is None:
            rows = band_ft(vertices, faces, density, self.band.rows, self.band.spacing, self.single)
            return self.band.to_box(rows).to(there)
        return elements_ft(
            vertices,
            faces,
            density,
            self.quadrature_of(len(faces)),
            self.spreading,
            self.single,
            there,
        )

    @kept
    def quadrature_of(self, faces: int) -> Points:
        """Return the rules for a mesh with as many faces as the one it was made for."""
        return Points(self.rules, faces)


def make_plan(
    vertices: np.ndarray,
    faces: np.ndarray,
    fft_shape: tuple[int, int, int],
    voxel_size: tuple[float, float, float],
    width: tuple[float, float, float],
    accuracy: float,
    method: Method | None = None,
    margin: float = 1.0,
    aligned: bool = True,
    cutoff: Cutoff | None = None,
    device: str = "cpu",
    transfer: Transfer | None = None,
    contrast: np.ndarray | None = None,
) -> Plan:
    """Choose band, method, rules and kernels for an accuracy.

    Parameters
    ----------
    vertices, faces
        (V, 3) um, (F, 3).
    fft_shape, voxel_size
        The periodic grid; um.
    width
        um along Z, Y, X: the band at threshold t reaches ``sqrt(2 ln(1/t)) / width`` (for a
        Gaussian PSF, ``1 / sqrt(inverse covariance)``, which is sigma where it is diagonal).
    accuracy
        Relative L2 error of the rendered image; 0 for the closed form at every wavevector.
    method
        Forces a method; by default the cheaper one.
    margin
        Rules are chosen as if edges were longer by this factor (a mesh that is being fitted moves).
    aligned
        Whether the axes of the PSF are those of the grid; otherwise all of the box is computed.
    cutoff
        Where the OTF ends, for a PSF that is not Gaussian.
    device
        Type of the device that computes: which method is cheaper depends on it.
    transfer
        |OTF| with everything that acts on it, whose aliases choose grid and kernels; by default
        that of a Gaussian of this width.
    contrast
        (F,) by how much what is behind each face is brighter than what is in front, on any scale,
        if insides shine rather than faces. Their power falls faster, so less has to be computed.

    Raises
    ------
    InputError
        If the accuracy is negative, not a number, or 1 or more.
    """
    check_accuracy(accuracy)
    method = checked_method(method)
    if accuracy < EXACT_BELOW:
        band = Band.full(fft_shape, voxel_size)
        phases = edge_phases(vertices, faces, tuple(pi / d for d in voxel_size), aligned=False)
        work = count_work("closed form", band, len(faces), phases, [], None)
        return Plan("closed form", band, accuracy, 0.0, False, None, [], 0.0, work, device)
    falloff = _falloff(vertices / np.asarray(width), faces, contrast)
    c = choose_band(falloff, fft_shape, voxel_size, width, accuracy, aligned, cutoff)
    phases = edge_phases(vertices, faces, c.held, c.round)
    rules = choose_rules(margin * phases, c.at_edge, c.quadrature, falloff.order > 2)
    seen = transfer or gaussian(width)
    spreading = spreading_for(c, rules, width, seen, falloff, contrast is not None)
    works: dict[Method, Work] = {
        m: count_work(m, c.band, len(faces), phases, rules, spreading) for m in METHODS
    }
    # Not the costs of this machine: the same settings give the same image everywhere.
    cheapest: Method = min(METHODS, key=lambda m: built_in(device).seconds(works[m], c.single))
    chosen = method if method is not None else cheapest
    # The law of the band is that of a smooth surface; corners and edges were found to add a sixth.
    error = min(accuracy, 1.2 * c.error)
    work, rest = works[chosen], (c.band, accuracy, c.threshold, c.single)
    if chosen == "closed form":
        return Plan(chosen, *rest, None, [], error, work, device)
    error = min(accuracy, float(np.hypot(np.hypot(error, c.quadrature), c.tolerance)))
    return Plan(chosen, *rest, spreading, rules, error, work, device)


def checked_method(method: str | None) -> Method | None:
    """Return a method by its name. InputError if there is none."""
    if method is not None and method not in METHODS:
        raise InputError(f"method must be 'closed form' or 'particle-mesh', not {method!r}")
    return method


def spreading_for(
    c: BandChoice,
    rules: list[tuple[Rule, np.ndarray]],
    width: tuple[float, float, float],
    transfer: Transfer,
    falloff: Falloff,
    dipoles: bool = False,
) -> Spreading:
    """Choose grid and kernels for a band; for dipoles if insides shine."""
    points = sum(len(r.weights) * len(of) for r, of in rules)
    return choose_spreading(
        c.band.half,
        c.band.spacing,
        transfer,
        c.tolerance,
        points,
        c.single,
        falloff,
        width,
        dipoles,
    )


@dataclass(frozen=True)
class BandChoice:
    """Band and precision that an accuracy requires, whatever the scene holds.

    tolerance, quadrature : relative L2 errors that aliases and quadrature may cause.
    held, at_edge : half axes (rad/um) of the band's part that the grid holds, |OTF| at its edge.
    round : whether that part is an ellipsoid; otherwise it has corners.
    error : expected from leaving out what is beyond it.
    """

    band: Band
    threshold: float
    single: bool
    tolerance: float
    quadrature: float
    held: tuple[float, ...]
    at_edge: float
    round: bool
    error: float


def choose_band(
    falloff: Falloff,
    fft_shape: tuple[int, int, int],
    voxel_size: tuple[float, float, float],
    width: tuple[float, float, float],
    accuracy: float,
    aligned: bool = True,
    cutoff: Cutoff | None = None,
) -> BandChoice:
    """Choose the band and precision for an accuracy."""
    error = _BAND_SHARE * accuracy
    if cutoff is not None:
        radius, threshold = cutoff(error, falloff)
    else:
        threshold = threshold_for(error, falloff)
        radius = tuple(sqrt(2 * log(1 / threshold)) / w for w in width)  # type: ignore[assignment]
        error = band_error(threshold, falloff)
    band = Band.within(fft_shape, voxel_size, radius, aligned)
    single = accuracy >= _SINGLE_ABOVE
    whole = all(2 * (k + 1) > n for k, n in zip(band.half, fft_shape, strict=True))
    more = accuracy * (_WHOLE if whole else 1.0)
    tolerance = max(_ALIAS_SHARE * more, 1e-6 if single else 1e-13)
    held, at_edge = _held(radius, voxel_size, threshold)
    if cutoff is not None:
        at_edge = _FLAT
    # A band that is cut off at the grid's own edge has corners.
    is_round = aligned and held == radius
    quadrature = RULE_SHARE * more
    return BandChoice(
        band, threshold, single, tolerance, quadrature, held, at_edge, is_round, error
    )


def _falloff(vertices: np.ndarray, faces: np.ndarray, contrast: np.ndarray | None) -> Falloff:
    """Return the falloff of faces, or of the solid within; vertices are in widths of the PSF."""
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = float(np.linalg.norm(normal, axis=1).sum() / 2)
    centred = corners[:, 0] - vertices.mean(0)
    if contrast is None:
        return of_surface(area, abs(float(np.einsum("fi,fi->", centred, normal)) / 6))
    # Every wall counts, as equally bright insides may come to differ.
    most = max(float(np.abs(contrast).max(initial=0.0)), 1e-300)
    volume = abs(float(np.einsum("fi,fi,f->", centred, normal, contrast / most)) / 6)
    return of_solid(area, volume)


def _held(
    radius: tuple[float, ...], voxel_size: tuple[float, ...], threshold: float
) -> tuple[tuple[float, ...], float]:
    """Return half axes of the part of a band that the grid holds, and |OTF| at its edge.

    The band of a PSF much narrower than a voxel reaches far beyond the grid; points for
    wavevectors that are not there would fill any memory. The least share along an axis is used for
    all: the flatter OTF only leads to finer rules.
    """
    nyquist = tuple(pi / d for d in voxel_size)
    share = min(n / r for n, r in zip(nyquist, radius, strict=True))
    if share > 0.5:
        return radius, threshold
    # Rounded down, so that the tables of one PSF serve similar ones.
    share = 2.0 ** (floor(2 * log2(share)) / 2)
    held = tuple(min(n, r) for n, r in zip(nyquist, radius, strict=True))
    return held, threshold ** (share**2)


def edge_phases(
    vertices: np.ndarray, faces: np.ndarray, radius: tuple[float, ...], aligned: bool
) -> np.ndarray:
    """Return (F,) largest phase along the longest edge of each face, anywhere in the band, rad."""
    if not len(faces):
        return np.zeros(0)
    corners = vertices[faces] * np.asarray(radius)
    edges = np.abs(corners - np.roll(corners, 1, axis=1))
    phases = np.sqrt((edges**2).sum(-1)) if aligned else edges.sum(-1)
    return phases.max(1)
