"""The numbers that decide what counts as a cell in an image, and how clicks change that."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class FindingRules:
    """When *Find cells* sees a cell. Lengths are in diameters of a cell.

    What a quarter less and a third more of a number changes is told with it, measured without the
    rules on noise (``white_within`` to ``rim_contrast``) on twelve clusters of
    benchmarks/defaults/tissues.py with their true size, and on the embryo of benchmarks/clusters:
    48 % of their cells are found so, and 46 of 56.

    Attributes
    ----------
    smoothing, sharpest
        Standard deviation of the image in which walls are sought, and the least, in the smallest
        sides of a voxel. Measured: 48 and 48 %, 45 and 44; of the least 44 and 40 %, 46 and 46.
    seed_smoothing
        Of the copy whose minima start the regions. Measured: 50 and 48 %, 46 and 44.
    finest
        Voxels smaller than this are put together, for speed.
    percentiles
        Of the smoothed image, its dark and bright level: single voxels would decide otherwise.
    floor, floor_noise
        Added before the logarithm: this part of the contrast, and not less than so many standard
        deviations of the noise, or noise in dark places would look like walls. Measured, of the
        first: 52 and 41 %, 47 and 44.
    join_below
        Two regions are one where the wall between them is lower: the logarithm of its brightness
        over that of the inside. Measured: 48 and 47 %, 47 and 43.
    wall
        So far above the inside, in the same units, a place on a surface counts as wall. Measured:
        48 and 48 %, 46 and 45.
    bound
        Heights count up to this where regions are joined: where a contact ends, in the bright walls
        around it, is no wall of its own.
    ready
        Factors on the height of a wall for regions smaller and larger than a cell: the first are
        joined more readily than the second.
    enclosed, enclosed_at_border
        Least share of a cell's surface that is on a wall. The more of it lies on the border of the
        image the better the rest must be enclosed, up to the second: corners of the outside have
        walls on one side, cut cells all around. Measured, of the first: 48 and 47 %, 47 and 42.
    height
        Least mean height over all of it: the edges of noise have up to 0.7. It decides where the
        noise is not that of single voxels, as after smoothing; else the next five do as well.
    white_within
        The noise is that of single voxels where neighbours in the finest pattern correlate by -2/3,
        to within this: simulated tissues have -0.65 to -0.68, two real stacks as the camera gave
        them -0.63 to -0.66, noise that a Gaussian of half a voxel has smoothed -0.56.
    noise_reach
        Standard deviation of the Gaussian over which noise is averaged: it is another in bright
        places than in dark ones.
    rim_lowest, clear, clear_at_border
        Least share of the surface, as with ``enclosed``, that is above the inside by the first, in
        standard deviations of the noise in the cell. Measured: see ``rim_contrast``.
    clear_border
        As ``border``, where these rules decide: of a halved ball it is 0.4, and haze between a
        cluster and the border of the image may have 0.65.
    rim_mean
        And so far above it on average: of cells that are found 98 % have 5.4 or more, of 10,000
        pieces of noise two have 4.5.
    rim_contrast
        Least height where these rules decide: gaps between cells have 0.3, so do spots of uneven
        light. On 20 tissues that nothing was chosen on, these rules find 95 % of the cells with
        their true size, and 57 % are found without them; a fifth less or more of a number gives 93
        to 96 %, but of ``clear`` 96 and 73 %.
    likely_per_border, likely_border, likely_gap
        Where others are cells for sure, what the border of the image cuts is one with less: for all
        of a ball's area on the border, so much more than ``clear``; the second as
        ``clear_border``, the third as ``gap``. Measured on 20 tissues and 20 crowds of balls, cut
        in six ways, of cells that are there by more than half. Of tissues 81.5 % are found, and 4
        gaps beside 1,600 cells; without these rules 70.8 %, and 4; with 0.4 as the first two 79 %,
        with 0.75 or 0.9 as the third 82 or 79 %. Of balls 92.3 %, as without, and 211 gaps in
        place of 202.
    sizes
        Smallest and largest diameter that is kept, in parts of the size asked for: what is less or
        more is a piece, or several, so that a rough size is enough.
    border
        Area on the border of the image over that of a ball of the same volume: a region with more
        than this is mostly outside, or is the background. Of a halved ball it is 0.4.
    gap, closed
        How enclosed a region is times how solid (its volume over that of its convex hull), both in
        parts of what the best quarter of the volume found has: less is a gap between cells, whose
        walls are theirs, bulge into it and end where they do not touch. Measured on 104
        simulated crowds and tissues: 226 of 354 gaps have less, and 1 of 1125 cells. With 0.7 it
        is 234 and 3, and two deep cells of an embryo are gone whose walls fade below.
        What is as enclosed as the second is a cell of whatever shape; chosen: no gap less is found.
    even, as_even
        How even the wall around a region is (`even_walls`) times how solid it is, and the same in
        parts of what the best quarter of the volume found has. Less is dark ground between cells,
        or a piece of one. Measured on 19 simulated images of 130 cells, most of different
        sizes: 161 were found without both, 52 of them wrong; 108 with both, 2 of them wrong. With
        0.44 as the first, it is 109 and 4; and in an embryo two of 43 cells are lost, with 0.4 one.
    leak, corners
        Parts of a region thinner than twice the first have leaked out of it; what lies within so
        many times that of the rest comes back, since corners are thin too.
    tried_voxels, smallest_tried
        A size is sought on about so many voxels, since more would take longer than a second, and
        down to cells of so many across: walls of smaller ones could not be told apart.
    first_tried, step
        The largest size tried, in longest sides of the image, and the ratio of each to the next: a
        size a quarter too small finds as many cells (measured on six clusters).
    alike
        Two sizes are those of the same cells if their logarithms differ by less: half as large
        again is more than cells of one kind differ by.
    least_voxels
        A cell's diameter, in voxels: in smaller ones an inside cannot be told from the walls.
    """

    smoothing: float = 0.03
    sharpest: float = 0.7
    seed_smoothing: float = 0.065
    finest: float = 1 / 40
    percentiles: tuple[float, float] = (0.5, 99.9)
    floor: float = 0.06
    floor_noise: float = 3.0
    join_below: float = 0.6
    wall: float = 0.4
    bound: float = 1.15
    ready: tuple[float, float] = (0.6, 1.6)
    enclosed: float = 0.6
    enclosed_at_border: float = 0.9
    height: float = 0.77
    white_within: float = 0.05
    noise_reach: float = 0.25
    rim_lowest: float = 2.0
    clear: float = 0.75
    clear_at_border: float = 0.95
    clear_border: float = 0.4
    rim_mean: float = 5.0
    rim_contrast: float = 0.35
    likely_per_border: float = 0.3
    likely_border: float = 0.5
    likely_gap: float = 0.82
    sizes: tuple[float, float] = (0.4, 2.0)
    border: float = 0.7
    gap: float = 0.62
    closed: float = 0.97
    even: float = 0.36
    as_even: float = 0.6
    leak: float = 0.12
    corners: float = 1.7
    tried_voxels: int = 60_000
    smallest_tried: int = 8
    first_tried: float = 0.8
    step: float = 1.3
    alike: float = 0.4
    least_voxels: int = 4


@dataclass(frozen=True)
class BasinRules:
    """When a point names a region.

    Attributes
    ----------
    border
        As in :class:`FindingRules`, for the same reason: a region with more is only background.
    same_object
        Two points are in one object when the pass between them is lower than this fraction of the
        rise from the inside to the leak.
    lower_leap
        Where the largest leap is that of the outside, one below it is taken instead, but only if it
        rises by at least this share of that one's rise.
    noise_rise
        A leap counts only if it rises above the lowest voxel by this many standard deviations of
        the noise: dark puddles of noise, which the minimum of many voxels deepens, are no objects.
    fewest
        Voxels: three along each axis, since fewer have no inside.
    sides
        Voxels along each axis of the blocks that are flooded first, the largest first. Chosen: with
        blocks of four, what remains takes longer.
    many
        Voxels of an image from which on blocks of two are flooded first; blocks of four from eight
        times as many on. Chosen: without the compiled extension, 700,000 take four seconds.
    blocks
        Of two voxels, in a basin, so many at least; of four, eight times as many. Measured: what is
        found with blocks and without has a Dice coefficient of 0.998 or more in 30 foams with cells
        of 4 to 11 voxels in radius, with blocks of four of 0.9993 in ten with cells of 22 to 28.
    """

    border: float = 0.7
    same_object: float = 0.6
    lower_leap: float = 0.25
    noise_rise: float = 8.0
    fewest: int = 27
    sides: tuple[int, ...] = (4, 2)
    many: int = 200_000
    blocks: int = 27


@dataclass(frozen=True)
class ClickRules:
    """What a click changes. Lengths are in diameters of a typical cell.

    Attributes
    ----------
    marker
        Radius of what a click marks, and of the seam that a merger closes; chosen by eye.
    reach
        A cell that is added ends at this distance from the click, wall or not, so that a click near
        one side of a cell reaches the other; and how far around the click the image is looked at,
        in reaches, which has to be more than the first.
    thin, corners
        Parts of a new cell thinner than twice the first are not kept; see
        ``FindingRules.corners``.
    fewest
        Voxels of a cell: three along each axis, since fewer have no inside.
    crumb
        Of the volume of a typical cell; less is a crumb, of which a fit can make no cell. Clicks at
        40 random places in the sound cells of the foam sample cut off crumbs of up to 0.05; the
        smallest part that a sound correction of the embryo makes (benchmarks/clusters) is 0.63.
    edge
        By how much the rim of a new cell is at least brighter, or darker, than its core, in the
        logarithm of the contrast; less is background. Measured: 0.45 and more for cells of vesicles
        and an embryo that were taken away and added again, up to 0.06 in dark background.
    named
        Of the volume of a typical cell: what a click names in the image without a wall around it is
        at least as large. Chosen, not measured: half as wide, with a little to spare.
    flat
        A way of one um costs this without a wall, and a wall's height squared more: a dim wall
        (0.5) three voxels wide counts like 40 voxels of nothing, so that ways go around it.
    """

    marker: float = 0.08
    reach: tuple[float, float] = (1.1, 1.2)
    thin: float = 0.06
    corners: float = 1.7
    fewest: int = 27
    crumb: float = 0.05
    edge: float = 0.15
    named: float = 0.15
    flat: float = 0.02


FINDING, BASINS, CLICKS = FindingRules(), BasinRules(), ClickRules()
