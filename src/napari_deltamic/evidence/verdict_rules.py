"""The numbers that decide whether a shape that a fit found is good, fair or poor."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class VerdictRules:
    """What lowers a grade; from the scenes of ``benchmarks.defaults`` and three real stacks.

    Attributes
    ----------
    good, fair
        Least share of the signal around the surfaces that is explained, noise left out. Real
        surfaces that lay where they should explained 0.79 to 0.95, as measured, wrong ones 0.11 to
        0.45.
    shown
        Least standard deviations of noise by which the image must show a cell of which not even
        ``fair`` is explained, or it is poor: where nothing shines, its shape follows noise.
        Measured: -2.5 to 4.4 in five cells whose labels lay where nothing shone; of faint cells 6.4
        in one of which the border left 81 voxels, 8.6 and more in others.
    stray
        Largest share of the light of a cell that one place of the residual may hold. Measured:
        scenes within 0.2 voxel had up to 0.09, nuclei and haze fitted as membranes 0.15 or more.
    widths
        Least and largest width of the blur that the image tells, over that of the PSF used.
        Measured: 0.9 to 1.1 where the PSF is right and layers are thin; 1.2 to 1.5 for layers of 3
        to 8 voxels and nuclei.
    along
        The least such width along Z. Measured: 0.89 or more in 86 of 88 scenes that were fitted
        with a Gaussian PSF, 0.54 and 0.72 where it stood in for a light cone (off by 1.7 voxels
        along Z); 0.41 in chromosomes that were taken for a membrane.
    far_off
        Such a width across or along Z below which the fit is poor: no image is half as wide as its
        PSF. Measured: 0.25 to 0.48 in six hazes seen by a widefield microscope, whose cells were
        1.2 to 9.9 voxels off.
    grown, shrunk
        Largest and least volume over that of the start; with four cells or more, over what it is in
        the others. Chosen, not measured: starts are rough, but hardly by so much.
    outgrown
        Such a volume, over what it is in the others, above which a cell is poor. Chosen; measured:
        20 in one of five cells, which had gone astray in a haze.
    left_out
        Most light of bright parts beside a cell that belong to none, over its own. Measured:
        0.08, 0.22 and 0.31 in cells whose labels lacked 8, 21 and 27 % of their volume, 0.05 in one
        that lacked 5 %; 0 in 526 other cells of which insides alone shine.
    inside
        Largest difference of the brightness deep inside a cell and outside, over that of its
        surface: with membranes alone it is within 0.02 of 0, with light inside or a haze around
        beyond 0.35.
    compact
        Least area of the sphere of the same volume over that of the cell, over what it was at the
        start: 0.9 to 1 where the shape was found, below 0.6 where it crumpled or swallowed a
        neighbour.
    lit, dark
        Least share of the surface of a cell that shines, below which it is fair, and poor: where
        nothing shines, the image tells no shape. Measured: vesicles 0.69 or more, cells of an
        embryo 0.49, of a gland 0.38; in an epithelium of which only the junctions shine, where all
        but these was wrong, 0.26 in the median.
    seen, unseen
        Least share of the surface of a cell that lies where the image is not missing, below which
        it is fair, and poor; the same where it did not count. Chosen, not measured: a dead slice of
        20 hides a twentieth.
    slices
        Least height of a cell, slices. Chosen: a slice between two surfaces, and one on each.
        Measured: six cells of 1.1 to 1.8 slices, which were good, were 0.66 voxel off; none between
        1.8 and 3.
    uneven
        Largest standard deviation of the brightness deep inside a cell, without noise: insides of
        one brightness had none, chromatin of 0.2 to 0.5 had 0.1 to 0.2, and borders were 0.2 to 0.6
        voxel off (benchmarks.defaults). It weighs by the inside's share of the brightness: by least
        squares on the profile of a flat border, an uneven inside moves the border 0.2 to 1 times
        as far as so weighed, for insides 0.01 to 100 times as bright as the membrane's peak.
    cut, cut_most
        Largest shares of the bright voxels that may be cut off at the largest value: for a good
        grade, and for a fair one. Measured in five scenes cut at three heights each: with 0.44 to
        0.75, 0.04 to 0.17 voxel off, 0.25 and 0.57 for nuclei; with 0.81, a membrane was taken for
        an inside, 2.2 voxels off.
    shifted
        Largest shift of slices against each other along Y and X, voxels. Measured
        (benchmarks.defaults): 0.35 to 0.78 in four stacks whose slices were shifted by 0.7, up to
        0.11 in 103 others; 0.13 in a real stack of vesicles that wobbles, up to 0.05 in three
        others.
    flicker
        Largest relative variation of the brightness of slices. Measured: 0.12 to 0.19 in four
        stacks where it did by a fifth, up to 0.07 in the others.
    dome
        Largest height of a dome of haze that the model may have taken for background, over its
        brightest light. Chosen, well below what was measured: 0.8 to 1.6 in three hazes that a
        widefield microscope saw, with cells 0.3 to 0.55 voxel off; 0 where a background rises from
        side to side.
    followed
        Least share of the image around the surfaces, other objects left out, that the way to them
        explains where the seeds explained hardly any of it. Measured: 0.15 to 0.37 in five fits of
        three scenes with labels shifted by more than a cell, which ended elsewhere; in 41 scenes
        with right labels 0.41 (patchy membranes) to 0.97.
    accuracy
        Largest relative error that rendered images may have. Chosen: half as much again as the
        coarsest that is ever chosen for a user; with 0.1, nuclei ended 0.6 and 1.0 voxel off where
        0.1 was predicted.
    astray
        Share of poor cells above which the whole is no better than fair. Chosen: where more than
        one cell in ten is wrong, the first word that a user reads is not "good". Measured: none of
        26 good fits of several cells (benchmarks.defaults) had a poor cell; in one of five cells
        that was called good, one had grown to 20 times its volume.
    error_good, error_fair
        Largest predicted error of the shape, in voxels (the geometric mean of their sides).
        Chosen: what a reader takes for right, and for a voxel off; not measured.
    doubts
        Reasons at once, of the fit and of a cell, from which on the cell is poor, however little
        each of them says. Measured on 357 fits of simulated scenes (some of one scene by several
        versions), by what half of the cells had: in five with this many, 0.37 to 5.3 voxels off; in
        seven with one less 0.24 to 7.0, three of them below 0.3; more than 0.5 in nine of 41 with
        two or three.
    """

    good: float = 0.75
    fair: float = 0.5
    shown: float = 5.0
    stray: float = 0.12
    left_out: float = 0.06
    widths: tuple[float, float] = (0.7, 1.3)
    along: float = 0.8
    far_off: float = 0.5
    grown: float = 3.0
    shrunk: float = 0.2
    outgrown: float = 10.0
    inside: float = 0.12
    compact: float = 0.65
    lit: float = 0.4
    dark: float = 0.3
    seen: float = 0.9
    unseen: float = 0.5
    slices: float = 3.0
    uneven: float = 0.1
    cut: float = 0.4
    cut_most: float = 0.78
    shifted: float = 0.2
    flicker: float = 0.1
    dome: float = 0.3
    followed: float = 0.4
    accuracy: float = 0.03
    astray: float = 0.1
    error_good: float = 0.3
    error_fair: float = 1.0
    doubts: int = 5


RULES = VerdictRules()
