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
        Most steps of a fit: another one has gone before, so that it starts near its end. Chosen:
        most end after five.
    enough
        Least gain, nats: a step that gains less is the last. By definition one standard deviation,
        where the threshold of a score is 3.5.
    same
        Largest move of the surface, widths of the PSF, and largest change of the image, as a share
        of it, for which the columns of the surface still hold. Chosen: they then change as little.
    prior
        Prior standard deviation of a mode, widths of the PSF, so that modes that no voxel sees stay
        where they are.
    prior_density
        The same for the logarithm of the density: a factor of e, since less would be evidence.
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
        Pairs of numbers: up to so many regions have this many modes each; and the modes of each of
        more regions. A few are enough, because what effects and shape share is smooth, and each
        mode costs a derivative of the image. On a sphere 25 are the harmonics up to degree 4.
    density
        Number of fields of the density on each region: the harmonics up to degree 2.
    alike
        Least share of a mode that must be left beside the others: less is the same mode again.
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
        Distances, widths of the PSF: from the surface, up to which voxels are evidence, so that a
        halo is seen beside the membrane; and from the piece judged, up to which cells still shine
        into it.
    most_cells
        Most cells that are judged: more tell hardly more of what all have in common, and take
        longer.
    hidden
        Least share of a column that is left beside shape and the rest: less cannot be told from
        them.
    blocks, fewest_blocks
        Sides of blocks, widths of the PSF: the PSF relates what is left of nearer voxels, and
        misfit that of voxels further still; and the fewest blocks that can tell a variance.
    largest_z
        Largest score that is told: nobody can read more into a larger one.
    misfit
        Variance of what is left, over that of noise, from which on it is worth a remark: scores are
        then relative to it, which a reader would not expect.
    negligible
        Least shift of the surface, voxels: an effect that moves it by less is not worth its price;
        noise alone scatters surfaces by more (docs/accuracy.md).
    accuracy
        Relative error of the images by which effects are judged, since small effects would drown
        in a larger one.
    most_rounds
        Most rounds in which an effect is added: more than there are effects to consider, so that
        all can be taken.
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
        Largest difference of the correlation of neighbours from that of white noise: beyond it an
        image was filtered or deconvolved, and its variances are not those of the camera.
    bins, fewest
        Number of bins of brightness, and the fewest voxels of a bin: variances of 60 squares are
        right within a fifth, which 48 bins average out.
    largest_error, surely_related
        Relative errors of the slope of the variance: beyond the first, the image does not tell the
        gain, beyond the second, not even that noise grows with brightness. Chosen: a fifth, and two
        standard errors from none.
    dark_radius, fewest_dark
        Distance, voxels, of the neighbours by whose mean a voxel is called dark, so that its own
        noise does not choose it; and the fewest dark voxels whose spread is that of read noise.
    looked_at
        Most voxels that are looked at: more would take longer than a second.
    cut_share, over_next, falls
        Dark voxels were cut where those of the least value are more than such a share of all, so
        many times those of the next value, and where this ratio is so many times the next ratio,
        since few photons fall off evenly. Measured on eleven stacks, three of them cut, two of 1
        and 3 photons: half and twice of the first and last change nothing; half of ``over_next``
        sees one more cut, of three tenths of the voxels, which 5 does not.
    levels
        Quantiles of the brightness between which bins lie: single voxels beyond would stretch them.
    noiseless
        Least noise over the largest value: less is rounding of single precision.
    flattest
        Least value of the line, as a share of the smallest variance: with less it would give
        weights without bounds. Measured: half and twice change nothing.
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
        Number of rings of wavenumbers in the plane. Measured: half and twice change widths by 0.5 %
        at most.
    fewest, many
        Voxels along each axis, below which nothing is told, and slices from which on all is taken
        for surfaces. Measured on 26 scenes of 6 to 11 slices (benchmarks.defaults): widths along Z
        are 0.7 to 1.7 times the true ones. Chosen.
    largest_error
        Largest relative error of a width that is told. Chosen, not measured: a start that is off by
        a quarter is still one.
    shape_error
        Relative error that is added to each: surfaces do not face every direction alike. Found on
        spheres and ellipsoids.
    longest_wave
        Longest wave, as a share of the image's side: longer ones tell of its frame. Measured: half
        and twice change widths by 0.2 % at most.
    looked_at, parts
        Most voxels of a part of the image, and the number of parts that are looked at, those with
        most structure: more would take longer than 2 s, as measured. The middle alone may hold
        nothing but the caps of a large cell, which tell no width in the plane.
    most_modes
        Most modes that a ring counts as, since those of one ring belong to one shape. Measured:
        half and twice change widths by 0.02 % at most.
    noise_floor, low_waves
        Quantiles of the power and of the wavenumbers from which the search for the noise and for
        the light starts. Measured: half and twice change nothing.
    starts
        Widths, voxels, from which the search starts; three, since there could be other minima.
        Measured: half and twice change nothing.
    light, noise
        How far from their starts the logarithms of the power of light and noise may go, so that the
        search stays where numbers are finite. Measured: half and twice change nothing.
    log_widths, at_bound
        Bounds of the logarithms of widths in voxels (0.2 to 12), and how near to either a width is
        not told: narrower ones leave no trace below the largest wavenumber, wider ones only the
        frame.
    log_flatness, log_flat
        Logarithm of how many times as long along Z as across cells are: its standard deviation
        where nothing is known, and its bounds. Chosen: from a fifth to five times. Measured on 53
        random scenes: half of the widths along Z are off by more than 0.07, and by 0.10 if cells
        are taken to be round; in the plane by 0.08 both times.
    log_share
        Standard deviation of the logarithms of the powers of surfaces and of insides around equal
        ones, so that the one that an image does not show has no errors. Chosen.
    dead
        Most missing slices in a row that are interpolated. Measured on a flat cell with 1, 2 and 3
        of them in its middle: its 0.45 um along Z look like 0.44, 0.42 and 0.38.
    fades
        Voxels from missing ones in which light fades. Measured on a flat cell of which a slope cuts
        half away: with 2, 4 and 8, its 0.45 um along Z look like 0.21, 0.30 and 0.38.
    sharp, above_noise
        The light at the longest wave, blurred by so many voxels, must be so many times the noise:
        otherwise there is none. Measured: half and twice change nothing.
    step
        Step of logarithms in difference quotients: rounding and curvature are both below 1e-6 then.
    narrowest
        Voxels, below which no width is used. By definition, as in :mod:`..optics.narrow`. From 0.5
        on, the PSF of real nuclei became a point (mean Dice index with labels drawn by hand 0.932,
        and 0.947 from 0.64).
    in_voxels
        Widths along Z and in the plane, voxels, up to which a fit may start from them: wider ones
        would be haze, not a PSF. Measured on random scenes: of 18 in which the spectrum gave 4 to
        6.7 voxels along Z alone, 17 were right along Z within a factor of 1.5 and the last within
        2; of four in which it gave more than 4 in the plane as well, all were 1.6 to 11 times too
        wide there.
    z_over_yx
        Bounds of the width along Z over that in the plane: from a thin light sheet with its error
        to a low aperture; no microscope has more, so that it would be something else than a PSF.
    """

    rings: int = 48
    fewest: int = 5
    many: int = 12
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
    log_share: float = 3.0
    dead: int = 3
    fades: float = 8.0
    sharp: float = 0.3
    above_noise: float = 3.0
    step: float = 1e-4
    narrowest: float = 0.6
    in_voxels: tuple[float, float] = (8.0, 4.0)
    z_over_yx: tuple[float, float] = (0.7, 7.0)


@dataclass(frozen=True)
class SliceRules:
    """What an image tells of its slices.

    Attributes
    ----------
    bright
        Share of a slice's voxels by which its structures are judged, the brightest: membranes fill
        about as much.
    fewest
        Fewest slices with structures: a slope and its error cannot be told from fewer.
    smoothed
        Width, voxels, by which slices are smoothed before their brightest voxels are taken: noise
        would choose these otherwise.
    least_error
        Least error of the peak of a correlation, voxels: shares of a voxel are not told better.
    largest_shift
        Largest shift of neighbouring slices, voxels: more is a stack that was put together wrongly.
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
        Distance from a surface, widths of the PSF, within which the residual is its cell's: there a
        membrane has light.
    spot
        Standard deviations above which voxels belong to a spot: more than noise has in 99.7 % of
        voxels.
    false_spots
        Spots expected in an image that the model explains: one in twenty images would show one.
    most_spots
        Most spots that are told: nobody can look at more.
    """

    near: float = 3.0
    spot: float = 3.0
    false_spots: float = 0.05
    most_spots: int = 50


REFIT, MODES, JUDGING = RefitRules(), ModeRules(), JudgingRules()
CAMERA, SPECTRUM, SLICES = CameraRules(), SpectrumRules(), SliceRules()
RESIDUAL = ResidualRules()
