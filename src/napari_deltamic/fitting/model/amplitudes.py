"""What shines, found with the shape: how bright membranes and insides are, and which of them stay.

Every rendering is compared as ``a * membranes + c * insides + b``. The three are linear, so they
are solved for, not stepped (variable projection: G. Golub and V. Pereyra, 1973); a is not negative,
c is where the medium around is brighter than the inside.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from torch import Tensor

from ...common.ball import ball_radius
from ...common.choices import Structure, StructureChoice
from ...common.triple import geometric_mean
from ...errors import InputError
from ...geometry.mesh import FloatArray, Mesh
from ...optics import Optics
from ...scene.light import INSIDES, MEMBRANES, Light
from .likelihood import centred_products


@dataclass(frozen=True)
class AmplitudeRules:
    """When insides can be told from membranes, and when membranes are too dim.

    Attributes
    ----------
    telling
        Widths of the PSF: radius of cells whose inside reaches further than the blur of their
        membrane (a cell of 1.5 widths was explained as well by an inside of 2.8 times its volume).
    clearly
        Times that radius, from which on cells that began smaller are asked again. Measured on 108
        fits of cells of 2 to 5 widths, with and without a haze: when the last level begins, those
        of up to 2.4 are found to be 2.6 or less. Volumes were off by at most 0.03 more than without
        asking. Those of insides of 4 widths without a haze and of 5, and of both of 3.3 without the
        strongest haze and of 4 and 5, were off by at most 0.08, not by 0.26 to 0.66.
    thin, flat
        Times that radius, up to which cells are thin, and of the radius of the ball as large, below
        which they are flat, both by :func:`all_flat`. Measured in widths of the PSF: 2.5 to 4.6 in
        simulated nuclei of 2.5 to 6 slices, of which three of eight ended with a quarter to a half
        of their volume; 4.5 to 5.0 in real ones; 9 in red blood cells, which need smooth membranes.
        Of the ball: 0.29 to 0.53 in those nuclei, 0.9 and more in round cells.
    unseen
        Of the insides' image: where membranes are dimmer than this beside it, they cannot be seen,
        and their amplitude is no scale.
    """

    telling: float = 2.5
    clearly: float = 1.06
    thin: float = 2.4
    flat: float = 0.7
    unseen: float = 1e-3


RULES = AmplitudeRules()
_ALIKE = 1e-9  # of 1 less the squared correlation: images closer than this are the same image


def light_of(
    structure: Structure, shown: Callable[[Light], Tensor], measured: Tensor, weights: Tensor
) -> Light:
    """What shines, scaled so that an amplitude above 0 goes with it.

    Parameters
    ----------
    structure
        What may shine.
    shown
        (N,) the image of a light at the voxels that count; asked for only where it is needed.
    measured, weights
        (N,) of these voxels.
    """
    if structure == "membrane":
        return MEMBRANES
    insides = shown(INSIDES)
    if structure == "both":
        return mixture(shown(MEMBRANES), insides, measured, weights)
    return _inside_alone(float(centred_products([insides, measured], weights)[0, 1]))


def mixture(membranes: Tensor, insides: Tensor, measured: Tensor, weights: Tensor) -> Light:
    """The light of the least weighted squares, all (N,) voxels that count.

    Scaled so that an amplitude above 0 goes with it.
    """
    found = centred_products([membranes, insides, measured], weights)
    (ss, sv, sy), (_, vv, vy), _ = found.tolist()
    if vv <= 0 or ss <= 0:
        return MEMBRANES if vv <= 0 else INSIDES
    free = ss * vv - sv * sv
    if free < _ALIKE * ss * vv:
        return MEMBRANES if sy > 0 else _inside_alone(vy)
    a = (vv * sy - sv * vy) / free
    c = (ss * vy - sv * sy) / free
    # Where membranes are too dim to be seen beside the inside, their amplitude is no scale.
    seen = a > 0 and a * a * ss > RULES.unseen**2 * c * c * vv
    return Light(1.0, c / a) if seen else _inside_alone(vy)


def _inside_alone(slope: float) -> Light:
    return Light(0.0, 1.0 if slope >= 0 else -1.0)


def inside_over_membrane(light: Light, widths: Sequence[float] | FloatArray) -> float:
    """How bright an inside is over the peak of a flat membrane's image; widths : (3,) um, PSF."""
    peak = abs(light.membrane) / (np.sqrt(2 * np.pi) * geometric_mean(widths))
    return abs(light.interior) / max(peak, 1e-300)


def may_shine(asked: StructureChoice, mesh: Mesh, optics: Optics) -> Structure:
    """What may shine when a fit begins; only what is closed has an inside.

    In cells that are hardly wider than the PSF an inside looks like a membrane, so they begin with
    one of the two; :func:`~.small_cells.nearer_of` asks the image which.
    """
    if not mesh.is_closed():
        if asked in ("interior", "both"):
            raise InputError("the surfaces are not closed: they have no interior to be labelled")
        return "membrane"
    if asked != "auto":
        return asked
    return "membrane" if all_small(mesh, optics) else "both"


def all_small(mesh: Mesh, optics: Optics, times: float = 1.0) -> bool:
    """Whether insides of most of its cells look like membranes through the PSF."""
    volumes = np.asarray(list(mesh.volumes().values()))
    return hardly_wider(float(np.median(volumes)), optics, times)


def all_flat(mesh: Mesh, optics: Optics) -> bool:
    """Whether most cells are flat, and so thin that their insides look like membranes.

    By three volumes over the area, which is the radius of a ball and 1.5 times the thickness of a
    sheet; here in widths of the PSF along each axis.

    optics : as at the start. Fits through another PSF, long along Z until it was given up, would
    have taken a crowd of nuclei for flat ones.
    """
    scaled = mesh.with_vertices(mesh.vertices_numpy() / np.asarray(optics.sigma_um))
    areas, each = scaled.areas(), scaled.volumes()
    area = np.array([areas[(scaled.regions == k).any(1)].sum() for k in each])
    volume = np.abs(list(each.values()))
    ball = ball_radius(volume)
    thickness = 3 * volume / area
    thin = np.median(thickness) <= RULES.thin * RULES.telling
    return bool(thin and np.median(thickness / ball) < RULES.flat)


def hardly_wider(volume: float, optics: Optics, times: float = 1.0) -> bool:
    """Whether insides of a cell of so many um^3 look like membranes through the PSF.

    times : factor of the radius up to which they do.
    """
    radius = ball_radius(abs(volume))
    least = times * RULES.telling * geometric_mean(optics.sigma_um)
    return bool(radius <= least)
