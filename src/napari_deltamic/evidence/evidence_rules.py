"""The numbers that decide which effects an image calls for, and what it tells of its camera.

``python -m benchmarks.effects`` measures what these values find and miss (docs/effects.md); what
single ones could be instead has been measured only where that is said. "Half and twice" are those
of ``python -m benchmarks.half_and_twice``, on its six small stacks.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class RefitRules:
    """Steps of the fit with an effect more or less, and what is free beside an effect.

    Attributes
    ----------
    most_steps
        Of a fit: one has gone before, so that it is near its end. Chosen: most end after five.
    enough
        Nats: steps that gain less are the last. By definition one standard deviation, where the
        threshold of a score is 3.5.
    same
        Columns of the surface hold while it moves by so many widths of the PSF at most, and the
        image changes by such a share of itself. Chosen: columns then change as little.
    prior
        Widths of the PSF: standard deviation of what a mode may be, so that modes that no voxel
        sees stay where they are.
    prior_density
        The same of a logarithm of the density: a factor of e, since less would be evidence.
    """

    most_steps: int = 12
    enough: float = 0.5
    same: tuple[float, float] = (0.03, 0.01)
    prior: float = 2.0
    prior_density: float = 1.0


@dataclass(frozen=True)
class ModeRules:
    """Changes of shape that an effect could pass for.

    Attributes
    ----------
    per_region, many
        Pairs: for up to so many regions, this many modes of each; and the modes of each for more
        regions. Few do, because what effects and shape share is smooth, and each mode costs a
        derivative of the image. On a sphere 25 are the harmonics up to degree 4.
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
    largest_error, surely_related
        Of the slope of the variance, relative: the first beyond which the image does not tell the
        gain, the second beyond which it does not tell that noise grows with brightness at all.
        Chosen: a fifth, and two standard errors from none.
    dark_radius, fewest_dark
        Voxels around one by whose mean it is called dark, so that its own noise does not choose it;
        with fewer dark voxels their spread is not that of read noise.
    looked_at
        Voxels that are enough: more would take longer than a second.
    cut_share, over_next, falls
        Dark voxels were cut where those of the least value are more than such a share of all, so
        many times those of the next value, and where this ratio is so many times the next ratio,
        since few photons fall off evenly. Measured on eleven stacks, three of them cut, two of 1
        and 3 photons: half and twice of the first and last change nothing; half of ``over_next``
        sees one more cut, of three tenths of the voxels, which 5 does not.
    levels
        Quantiles of the brightness between which bins lie: single voxels beyond would stretch them.
    noiseless
        Noise over the largest value: less is rounding of single precision.
    flattest
        Of the smallest variance: a line that falls below it would give weights without bounds.
        Measured: half and twice change nothing.
    """

    coloured: float = 0.06
    bins: int = 48
    fewest: int = 60
    largest_error: float = 0.2
    surely_related: float = 0.5
    dark_radius: int = 2
    fewest_dark: int = 2000
    looked_at: int = 4_000_000
    cut_share: float = 0.005
    over_next: float = 5.0
    falls: float = 3.0
    levels: tuple[float, float] = (0.001, 0.9995)
    noiseless: float = 1e-7
    flattest: float = 0.2


@dataclass(frozen=True)
class SpectrumRules:
    """When the spectrum of an image tells the width of its PSF.

    Attributes
    ----------
    rings
        Of wavenumbers in the plane. Measured: half and twice change widths by 0.5 % at most.
    largest_error
        Relative. Chosen, not measured: a start that is off by a quarter is still one.
    shape_error
        Relative, added to each error: surfaces do not face every direction alike. Found on spheres
        and ellipsoids.
    longest_wave
        Of the image's side: longer waves tell of its frame. Measured: half and twice change widths
        by 0.2 % at most.
    looked_at, parts
        Voxels of each part that is looked at, and how many of those with most structure: more would
        take longer than 2 s, as measured. The middle alone may hold nothing but the caps of a large
        cell, which tell no width in the plane.
    most_modes
        That a ring counts as, since the modes of one ring belong to one shape. Measured: half and
        twice change widths by 0.02 % at most.
    noise_floor, low_waves
        Quantiles of the power and of the wavenumbers from which the search for the noise and for
        the light starts. Measured: half and twice change nothing.
    starts
        Voxels: widths from which it is searched for; three, since there could be other minima.
        Measured: half and twice change nothing.
    light, noise
        Logarithms of power: how far from its start each may go, so that the search stays where
        numbers are finite. Measured: half and twice change nothing.
    log_widths, at_bound
        Logarithms of widths in voxels (0.2 to 12), and how near to either end a width is not told:
        narrower ones leave no trace below the largest wavenumber, wider ones only the frame.
    log_flatness, log_flat
        Logarithm of how many times as long along Z as across cells are: its standard deviation
        where nothing is known, and its bounds. Chosen: from a fifth to five times. Measured on 53
        random scenes: half of the widths along Z are off by more than 0.07, and by 0.10 if cells
        are taken to be round; in the plane by 0.08 both times.
    dead
        Missing slices in a row that are interpolated. Measured on a flat cell with 1, 2 and 3 of
        them in its middle: its 0.45 um along Z look like 0.44, 0.42 and 0.38.
    fades
        Voxels from missing ones in which light fades. Measured on a flat cell of which a slope cuts
        half away: with 2, 4 and 8, its 0.45 um along Z look like 0.21, 0.30 and 0.38.
    sharp, above_noise
        The light at the longest wave, blurred by so many voxels, must be so many times the noise:
        otherwise there is none. Measured: half and twice change nothing.
    step
        Of logarithms, in differences: rounding and curvature are both below 1e-6 then.
    in_voxels
        Widths along Z and in the plane that a fit may start from: narrower ones the voxels cannot
        tell, and wider ones would be haze, not a PSF. Measured on random scenes: of 18 in which the
        spectrum gave 4 to 6.7 voxels along Z alone, 17 were right along Z within a factor of 1.5
        and the last within 2; of four in which it gave more than 4 in the plane as well, all were
        1.6 to 11 times too wide there.
    z_over_yx
        Of the widths: from a thin light sheet with its error to a low aperture; no microscope has
        more, so that it would be something else than a PSF.
    """

    rings: int = 48
    largest_error: float = 0.25
    shape_error: float = 0.08
    longest_wave: float = 0.5
    looked_at: int = 3_000_000
    parts: int = 4
    most_modes: float = 200.0
    noise_floor: float = 0.05
    low_waves: float = 0.2
    starts: tuple[float, ...] = (0.8, 1.5, 3.0)
    light: tuple[float, float] = (-12.0, 12.0)
    log_widths: tuple[float, float] = (-1.6, 2.5)
    noise: tuple[float, float] = (-4.0, 6.0)
    at_bound: float = 0.01
    log_flatness: float = 1.0
    log_flat: tuple[float, float] = (-1.6, 1.6)
    dead: int = 3
    fades: float = 8.0
    sharp: float = 0.3
    above_noise: float = 3.0
    step: float = 1e-4
    in_voxels: tuple[tuple[float, float], ...] = ((0.5, 8.0), (0.5, 4.0))
    z_over_yx: tuple[float, float] = (0.7, 7.0)


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
CAMERA, SPECTRUM, SLICES = CameraRules(), SpectrumRules(), SliceRules()
RESIDUAL = ResidualRules()
