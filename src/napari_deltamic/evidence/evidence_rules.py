"""The numbers that decide which effects an image calls for, and what it tells of its camera.

``python -m benchmarks.effects`` measures what these values find and miss (docs/effects.md); what
single ones could be instead has been measured only where that is said.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class RefitRules:
    """Gauss-Newton steps over smooth modes of the shape and all other numbers.

    Attributes
    ----------
    largest_psf
        Of one step, in the PSF's own numbers (logarithms of widths): further away the image is no
        longer linear in them.
    prior
        Widths of the PSF: standard deviation of what a mode may be, so that modes that no voxel
        sees stay where they are.
    prior_density
        The same of a logarithm of the density: a factor of e, since less would be evidence.
    halvings, most_steps
        Of a step that does not lower the loss, and of a refit: a fit has gone before, so that it
        is near its end.
    enough
        Of the loss: steps that gain less are the last. The threshold of a score is 3.5 standard
        deviations, that is 12 of a sum over thousands of voxels, of which this is a small part.
    little
        Of the loss: after a step that gains less the next has the same derivatives, because all
        derivatives change as little as the image.
    near, fresh
        Derivatives in the surface hold while it moves by so many widths of the PSF at most, and the
        image changes by such a share of itself: by the second for scores, by the first for steps,
        which only have to point the right way.
    """

    largest_psf: float = 0.15
    prior: float = 2.0
    prior_density: float = 1.0
    halvings: int = 4
    most_steps: int = 6
    enough: float = 2e-5
    little: float = 1e-2
    near: tuple[float, float] = (0.3, 0.15)
    fresh: tuple[float, float] = (0.03, 0.01)


@dataclass(frozen=True)
class ModeRules:
    """Changes of shape that an effect could pass for.

    Attributes
    ----------
    per_region, many
        Modes of each region for up to so many regions, and for more: what effects and shape share
        is smooth, and columns are dear. On a sphere 25 are the harmonics up to degree 4.
    density
        Fields of the density on each region: the harmonics up to degree 2.
    alike
        Share of a mode that must be left beside the others: less is the same mode again.
    """

    per_region: tuple[tuple[int, int], ...] = ((2, 25), (6, 16), (20, 9))
    many: int = 4
    density: int = 9
    alike: float = 1e-2


@dataclass(frozen=True)
class JudgingRules:
    """Where an effect is judged, and what is worth taking.

    Attributes
    ----------
    reach, seen
        Widths of the PSF: from the surface up to which voxels are evidence, so that a halo is seen
        beside the membrane; beyond the piece from which light still falls into it.
    most_cells
        More tell hardly more of what all have in common, and take longer.
    hidden
        Of a column, left beside shape and the rest: less cannot be told from them.
    blocks, fewest_blocks
        Sides in widths of the PSF: the noise of nearer voxels is related by it, and misfit further
        still. With fewer blocks a variance cannot be told.
    largest_z
        What a score is called at most: nobody can read more into a larger one.
    misfit
        Variances of noise from which on what is left is worth a remark: scores are then relative
        to it, which a reader would not expect.
    negligible
        Voxels: an effect that moves the surface by less is not worth its price; noise alone
        scatters surfaces by more (docs/accuracy.md).
    accuracy
        Of the images by which effects are judged, since small ones would drown in the error of a
        coarser one.
    most_rounds
        Of adding an effect: more than there are effects to consider, so that all can be taken.
    """

    reach: float = 8.0
    seen: float = 5.0
    most_cells: int = 6
    hidden: float = 0.02
    blocks: tuple[float, ...] = (4.0, 8.0, 16.0, 32.0)
    fewest_blocks: int = 12
    largest_z: float = 99.0
    misfit: float = 1.3
    negligible: float = 0.02
    accuracy: float = 1e-3
    most_rounds: int = 10


@dataclass(frozen=True)
class CameraRules:
    """When an image tells gain, offset and read noise.

    Attributes
    ----------
    coloured
        How far the correlation of neighbours may be from that of white noise: beyond it an image
        was filtered or deconvolved, and its variances are not those of the camera.
    bins, fewest
        Of brightness, and the voxels that one needs: variances of 60 squares are right within a
        fifth, which 48 bins average out.
    largest_error
        Of the gain, relative: beyond it the image does not tell.
    dark_radius, fewest_dark
        Voxels around one by whose mean it is called dark, so that its own noise does not choose it;
        with fewer dark voxels their spread is not that of read noise.
    looked_at
        Voxels that are enough: more would take longer than a second.
    """

    coloured: float = 0.06
    bins: int = 48
    fewest: int = 60
    largest_error: float = 0.2
    dark_radius: int = 2
    fewest_dark: int = 2000
    looked_at: int = 4_000_000


@dataclass(frozen=True)
class SliceRules:
    """What an image tells of its slices.

    Attributes
    ----------
    bright
        Share of a slice's voxels that its structures are judged by: membranes fill about as much.
    fewest
        Slices with structures: a slope and its error cannot be told from fewer.
    smoothed
        Voxels: of slices before they are compared, or noise would make the brightest voxels.
    least_error
        Voxels, of the peak of a correlation: shares of a voxel are not told better.
    largest_shift
        Voxels, of neighbouring slices: more is a stack that was put together wrongly.
    """

    bright: float = 0.02
    fewest: int = 6
    smoothed: float = 1.0
    least_error: float = 0.02
    largest_shift: int = 4


@dataclass(frozen=True)
class BeadRules:
    """How a bead's image is fitted.

    Attributes
    ----------
    difference, place_step
        By which derivatives in the PSF's numbers and in the place (um) are taken: as small as
        images in double precision allow, and less than any PSF can show.
    least_first
        um: the least diameter that a search for it starts from, since a smaller bead is a point to
        any microscope and the derivative in its diameter vanishes.
    diameters
        um, least and largest: beads that are made.
    first_core, cores
        Of the diameter of a bead stained at its rim: where a search starts, and what it may be; a
        core of nothing or of all would be a solid or a shell.
    settled
        Relative fall of the residual that is the end: less than the noise of one of ten thousand
        voxels.
    accuracy
        Of the images: below the noise of any bead's image.
    """

    difference: float = 1e-3
    place_step: float = 1e-3
    least_first: float = 0.2
    diameters: tuple[float, float] = (1e-2, 50.0)
    first_core: float = 0.7
    cores: tuple[float, float] = (0.02, 0.98)
    settled: float = 1e-4
    accuracy: float = 1e-3


@dataclass(frozen=True)
class ResidualRules:
    """Where a fit leaves something unexplained.

    Attributes
    ----------
    near
        Widths of the PSF from a surface that are its cell's: there a membrane has light.
    spot
        Standard deviations of what belongs to a spot: more than noise has in 99.7 % of voxels.
    false_spots
        Expected in an image that the model explains: one in twenty images would show one.
    most_spots
        That are told: nobody can look at more.
    """

    near: float = 3.0
    spot: float = 3.0
    false_spots: float = 0.05
    most_spots: int = 50


REFIT, MODES, JUDGING = RefitRules(), ModeRules(), JudgingRules()
CAMERA, SLICES = CameraRules(), SliceRules()
BEAD, RESIDUAL = BeadRules(), ResidualRules()
