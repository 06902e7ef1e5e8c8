"""Which amplitudes stay in the model: membranes, insides, or both.

An amplitude counts by what of its image no displacement of the surface can replace: an inside that
ends a little further out looks like a brighter membrane. So what each patch of surface would show
if it moved along its normal, and what another PSF would show where that is fitted, are taken out of
both images first (R. Frisch and F. Waugh, 1933). Standard errors are those of sums over blocks, as
what a fit leaves is alike in neighbouring voxels (H. White, 1980).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch

from ...common.choices import Structure
from ...common.triple import geometric_mean
from ...geometry.mesh import FloatArray, Mesh
from ...scene.light import INSIDES, MEMBRANES
from ..model.amplitudes import inside_over_membrane
from ..model.likelihood import products
from ..model.variables import Variables
from ..solvers.lbfgs import dot
from .posterior import Evaluation, Posterior
from .prediction import as_floats


@dataclass(frozen=True)
class StructureRules:
    """When an amplitude leaves the model.

    Attributes
    ----------
    errors
        Standard errors by which insides must differ from 0 to stay (benchmarks.defaults).
    membranes, outshone
        Standard errors by which membranes must differ from 0 to stay, where insides do by at least
        ``outshone`` times as many of theirs.
        Measured (benchmarks.defaults): where nuclei with chromatin shine alone, 3 to 4, and insides
        30 to 60 times as many; where there were membranes, 8 to 300, and 1 to 5 while their shape
        was off, with insides at one to five times as many.
    over
        Of the peak of a membrane's image, below which insides do not outshine it. Chosen between
        what was measured: 0.06, and 0.45 to 0.58, in two cells whose uneven membranes differed from
        0 by 0.7 and 1.3 to 5 standard errors, insides by -9 and 6 to 30 (as insides alone, they
        ended at 2.1 and 2.0 times their volumes); 0.86 to 0.95 in a nucleus with chromatin and
        nucleoli (as both, at two thirds of its volume).
    faint
        Times as many of their errors, up to which such membranes are tried without once the fit has
        come to rest. Measured: 5 to 7.5 errors in three fits of nuclei alone that had ended with a
        membrane 0.4 to 0.7 voxel outside of a smaller inside; 12 and more where both shone.
    beside_cut
        In place of ``membranes`` where voxels were cut: until insides are as bright as their
        borders say, their flat tops look like membranes. Measured after a few steps: 6 in crowds of
        nuclei, 11 in one whose membranes shine as well.
    moves
        Voxels. An amplitude also leaves where the surface would move by less than this without it,
        root mean square: the bound below which effects are left out, too.
    sure
        Where insides and membranes exceed these bounds this many times, the question is not asked
        again in a level: asking at every renewal took a third of the time of an embryo's fit, and
        the answer stayed the same.
    block
        Side of the blocks in widths of the blurred PSF: what is left is correlated over about two.
    step
        Displacement by which derivatives are taken, in widths of the PSF: so that their error, of
        second order, is below a thousandth.
    most
        Voxels that are asked, about. Chosen: a row of them takes 32 MB; images have more with some
        hundred cells.
    """

    errors: float = 3.0
    membranes: float = 5.0
    outshone: float = 6.0
    over: float = 0.7
    faint: float = 3.0
    beside_cut: float = 8.0
    moves: float = 0.02
    sure: float = 3.0
    block: float = 4.0
    step: float = 0.05
    most: int = 4_000_000


RULES = StructureRules()
_RANK = 1e-10  # of columns: less is rounding
_UNSEEN = 1e-6  # of the stiffest block: there the image cannot say where the surface lies


@dataclass(frozen=True)
class Told:
    """What an image says of an amplitude.

    Attributes
    ----------
    errors
        Standard errors by which it differs from 0.
    moves
        um, root mean square over patches: how far the surface would move without it.
    """

    errors: float
    moves: float


@dataclass(frozen=True)
class Chosen:
    """What stays.

    Attributes
    ----------
    structure
        Of membranes, insides, both.
    sure
        Whether that is so clear that it need not be asked again soon.
    outshone, faint
        Where both stay: whether insides differ from 0 by many times as many errors as membranes,
        and whether these do by so few, too, that insides may do alone.
    """

    structure: Structure
    sure: bool
    outshone: bool = False
    faint: bool = False


def chosen(
    posterior: Posterior,
    at: Variables,
    now: Evaluation,
    mesh: Mesh,
    sharpened: Callable[[], bool],
) -> Chosen:
    """What stays of a model in which both may shine; where neither is clear, membranes do.

    sharpened : whether the image was deconvolved, which draws bright rims around insides. Measured
    on crowds of nuclei, with and without fainter membranes: insides alone ended 0.27 and 0.30 voxel
    off, both 0.95 and 0.51.
    """
    membranes, insides = told(posterior, at, now, mesh)
    voxel = geometric_mean(posterior.level.frame.voxel_size)

    def stays(times: float) -> bool:
        errors, moves = times * RULES.errors, times * RULES.moves * voxel
        return abs(insides.errors) > errors and insides.moves > moves

    if not stays(1.0):
        return Chosen("membrane", False)
    outshone = abs(insides.errors) > RULES.outshone * membranes.errors
    over = inside_over_membrane(now.light, posterior.prior.imaging.optics.sigma_um)
    outshone &= over > RULES.over
    cut = posterior.views[0].voxels.full is not None
    least = RULES.beside_cut if cut else RULES.membranes
    if outshone and (membranes.errors <= least or sharpened()):
        return Chosen("interior", False)
    sure = stays(RULES.sure) and membranes.errors > RULES.sure * RULES.errors
    faint = membranes.errors <= RULES.faint * least and outshone
    return Chosen("both", sure, outshone, faint)


def told(
    posterior: Posterior,
    at: Variables,
    now: Evaluation,
    mesh: Mesh,
) -> tuple[Told, Told]:
    """What the image tells of membranes and of insides; now : the evaluation there.

    Of membranes that are equally bright: those that the fit has made bright where that explains
    noise would differ from 0 by fifteen errors in an image of nuclei alone.
    """
    rows, block = _blocks(posterior, RULES.block)
    root = np.sqrt(as_floats(posterior.views[0].voxels.weights)[rows])
    further = posterior.imaging_columns(at, rows)[0].T
    insides, measured = posterior.shown(at, INSIDES)[rows], posterior.measured(at)[0][rows]
    patch = _patches(posterior, at, now, mesh, RULES.step)[rows] * root
    results = []
    for which, known in enumerate((replace(at, density=np.zeros_like(at.density)), at)):
        membranes = posterior.shown(known, MEMBRANES)[rows]
        columns = membranes, insides, 1.0, *further, measured
        table = np.empty((len(columns), len(root)))  # written into: with many cells it is gigabytes
        for row, column in zip(table, columns, strict=True):
            np.multiply(column, root, out=row)
        results.append(_told(table, patch, block, which))
    return results[0], results[1]


def _told(table: FloatArray, patch: FloatArray, block: np.ndarray, which: int) -> Told:
    """What the image tells of one amplitude.

    table : (K + 1, N) weighted columns, the last one what was measured; it is overwritten.
    patch, block : (N,).
    """
    stiff = np.bincount(block, patch * patch)
    seen = stiff > _UNSEEN * stiff.max(initial=0.0)
    safe = np.where(seen, stiff, np.inf)
    # How far each patch would have to move to show a column, um.
    moves = np.stack([np.bincount(block, patch * column) / safe for column in table])
    scale = np.sqrt([(column**2).sum() for column in table[:-1]]) + 1e-300
    gram = _products(table[:-1]) / scale / scale[:, None]  # of a column of zeros: zero
    per_one = moves[:-1] / scale[:, None]
    for column, move in zip(table, moves, strict=True):
        column -= patch * move[block]
    x, y = table[:-1], table[-1]
    x /= scale[:, None]
    inverse = np.linalg.pinv(_products(x), rcond=1e-12, hermitian=True)
    found = inverse @ np.array([dot(a, y) for a in x])
    for a, times in zip(x, found, strict=True):
        y -= times * a
    scores = np.stack([np.bincount(block, y * column) for column in x])
    errors = np.sqrt(np.diag(inverse @ (scores @ scores.T) @ inverse)) + 1e-300
    # What the other columns cannot show in its place, the surface has to.
    others = np.arange(len(found)) != which
    share = np.linalg.lstsq(gram[others][:, others], gram[others][:, which], rcond=_RANK)[0]
    move = found[which] * (per_one[which] - share @ per_one[others])[seen]
    rms = np.sqrt(np.average(move**2, weights=stiff[seen])) if seen.any() else 0.0
    return Told(float(found[which] / errors[which]), float(rms))


def _patches(
    posterior: Posterior, at: Variables, now: Evaluation, mesh: Mesh, step: float
) -> FloatArray:
    """(N,) what the image changes by where the surface moves along its normal, per um."""
    level = posterior.level
    um = step * level.width / level.factor
    out, back = (posterior.shown(_displaced(at, mesh, by), now.light) for by in (um, -um))
    return np.asarray(now.match.amplitude * (out - back) / (2 * um))


def _products(columns: FloatArray) -> FloatArray:
    given = [torch.from_numpy(column) for column in columns]
    return products(given, torch.ones_like(given[0]))


def _displaced(at: Variables, mesh: Mesh, by: float) -> Variables:
    """Every vertex moved along its normal (um)."""
    normals = mesh.with_vertices(at.vertices).normals() * mesh.areas()[:, None]
    each = np.zeros_like(at.vertices)
    for corner in range(3):
        np.add.at(each, mesh.faces[:, corner], normals)
    each /= np.linalg.norm(each, axis=1, keepdims=True) + 1e-300
    return replace(at, vertices=at.vertices + by * each)


def _blocks(posterior: Posterior, side: float) -> tuple[np.ndarray, np.ndarray]:
    """Rows of the voxels that are asked, and the block that each is in: all of every some blocks.

    A few million voxels tell enough, and copies of all of them are gigabytes.
    """
    level = posterior.level
    um = side * level.factor * np.asarray(posterior.prior.imaging.optics.sigma_um)
    each = np.maximum(1, np.rint(um / np.asarray(level.grid.voxel_size))).astype(np.int64)
    index = posterior.views[0].voxels.index.cpu().numpy()
    every = -(-len(index) // RULES.most)
    rows, blocks = [], []
    for first in range(0, len(index), RULES.most):
        at = np.unravel_index(index[first : first + RULES.most], level.grid.shape)
        places = [k // n for k, n in zip(at, each, strict=True)]
        block = np.ravel_multi_index(places, tuple(-(-np.asarray(level.grid.shape) // each)))
        asked = np.flatnonzero(block % every == 0)
        rows.append(first + asked)
        blocks.append(block[asked])
    numbers = np.concatenate(blocks)
    taken = np.bincount(numbers) > 0
    return np.concatenate(rows), np.cumsum(taken)[numbers] - 1
