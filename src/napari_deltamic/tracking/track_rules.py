"""The numbers that decide in tracking: what a frame must show, what a division is, what is lost.

With these values ``python -m benchmarks.clusters`` finds the division of its series in its own
frame, with all identities right over ten frames; how far each could be off before that changes has
not been measured.
"""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class FrameRules:
    """Numbers that decide which frames are used.

    Attributes
    ----------
    known
        Least share of known voxels: with fewer, most cells would have no image.
    dim, blurred
        Least contrast and sharpness, relative to the median of the frames remembered. That follows
        bleaching; only a shutter or a lost focus is beyond it.
    saturated, many_times
        Largest share of voxels at the largest value, and how many times the usual share it must
        also exceed, so that stacks with a few saturated voxels are used.
    worse, much
        A fit is not trusted if its loss is this many times the usual, and larger by this much:
        noise and growth change it less, and losses near 0 would be compared by noise otherwise.
    odd
        Times the usual loss beyond which a frame is fitted again. Measured: 21 frames of a real
        droplet had 0.9 to 1.2 times the usual, and 1.6 where the fit had ended elsewhere.
    remembered
        Number of frames that define what is usual: odd, so that one bad frame is not the median.
    background, brightest
        Percentiles of a frame that are its dark and bright level; single hot voxels would decide
        otherwise.
    detail
        Widths of the PSF beyond which structure is not fine: membranes are, cells are not.
    """

    known: float = 0.3
    dim: float = 0.2
    blurred: float = 0.5
    saturated: float = 0.02
    many_times: float = 5.0
    worse: float = 2.0
    much: float = 0.25
    odd: float = 1.5
    remembered: int = 5
    background: float = 20.0
    brightest: float = 99.5
    detail: float = 1.5


@dataclass(frozen=True)
class MotionRules:
    """Numbers that decide where the fit of a frame may start.

    Attributes
    ----------
    blur
        Widths of the PSF that compared images are blurred to, so that membranes that have moved
        by two widths still overlap.
    smoothing
        lambda of displacements over the surface: cells that part would tear triangles otherwise.
    all_by, one_by
        Farthest shift of all, as a share of the field of view, and of a single cell besides, as a
        share of its radius: further away is the place of a neighbour, since cells are as near as
        two radii.
    near
        A start nearer than this many widths needs no blurred level, since a sharp one reaches it.
    far
        By how much the correlation must be better for the farthest shift than for none. Cells look
        alike: of two shifts that are almost as good, the shorter one is taken.
    better
        Share of the loss of the plainest start that another must come below: less than noise
        changes it would have meshes hop.
    accuracy
        Of images that are only ranked, since all of them have the same error.
    around, edge
        Voxels of blur, and level, that make a mask of a cell and about two voxels more: its
        membrane is what moves.
    overlap
        Least share of a mask that must be seen at a shift; with less, two voxels would correlate.
    """

    blur: float = 2.0
    smoothing: float = 4.0
    all_by: float = 0.3
    one_by: float = 0.6
    near: float = 1.5
    far: float = 0.05
    better: float = 0.98
    accuracy: float = 1e-2
    around: float = 1.5
    edge: float = 0.05
    overlap: float = 0.5


@dataclass(frozen=True)
class DivisionRules:
    """Numbers that decide whether a cell has divided.

    Attributes
    ----------
    directions
        Planes tried over half a sphere, 9 degrees apart: between two of them a wall as wide as a
        cell of seven PSF widths tilts by half a width, and would still be found.
    interior
        Widths of the PSF from the surface: nearer, a residual may be the surface's own.
    fewest
        Voxels of an interior: with fewer, noise alone makes planes.
    sure
        Standard deviations of the noise: so many, since hundreds of planes and offsets are tried
        and a residual is not noise alone.
    wall
        Least and largest brightness relative to two membranes: a young wall is dim, since it has
        only begun; what is brighter is a nucleus or debris.
    sectors, least_sector
        Directions around the middle of a wall, in each of which it must have this share of its
        mean brightness: an edge or a spot would pass for a wall otherwise.
    smallest
        Share of the volume on either side: daughters are about alike, debris at the rim is not.
    gain
        Share of the squared residual in the cell that a wall must explain: the best of hundreds of
        planes has about 12 variances of the noise by chance, which is as much of 300 voxels.
    along
        Share of a wall along which the surface of a cell that has folded in must lie: with less, a
        part of it is still one cell.
    folded
        Share by which two daughters may explain a cell worse than a single one that has folded in
        along the wall: its brightness has become uneven for that, by 0.73 to 1.96 where 3 % were
        seen.
    rounds
        Of looking in one frame: so that one cell may give four, which is more than any does.
    """

    directions: int = 150
    interior: float = 1.2
    fewest: int = 60
    sure: float = 8.0
    wall: tuple[float, float] = (0.35, 2.5)
    sectors: int = 6
    least_sector: float = 0.25
    smallest: float = 0.15
    gain: float = 0.04
    along: float = 0.5
    folded: float = 0.1
    rounds: int = 3


@dataclass(frozen=True)
class AlarmRules:
    """Numbers that decide whether a cell has lost its identity, or has gone.

    Attributes
    ----------
    slid
        Share of a cell on the place of another: with more than half it is rather that one.
    volume
        Least and largest volume relative to the last frame's: a division halves it.
    change, unusual
        Volume relative to the median of the frames remembered, at least, and how many times the
        usual logarithm of that. Chosen: single real droplets of a constant volume scatter by 1 %,
        and fits that ended elsewhere were off by 10 to 30 %.
    remembered, known
        Frames, and changes of all cells before anything is called usual. Chosen.
    jump
        Radii between where a cell was expected and where it is: a neighbour is two away.
    in_view
        Share of its vertices that must be in view: of less than a third no shape can be told.
    gone
        Share of the largest volume that it had: two divisions leave a quarter, so that a third of
        that is less than any cell that still divides.
    """

    slid: float = 0.5
    volume: tuple[float, float] = (0.5, 2.0)
    change: float = 1.08
    unusual: float = 5.0
    remembered: int = 5
    known: int = 4
    jump: float = 0.7
    in_view: float = 0.35
    gone: float = 0.08


@dataclass(frozen=True)
class MeshRules:
    """Numbers that decide whether the mesh of the last frame is remeshed for the next.

    Attributes
    ----------
    poor_angle, poor_share
        Degrees, and the share of triangles with a smaller angle: a fit remeshes at 15 degrees, and
        a frame should not begin with what the fit would have to repair at once.
    edge_change
        Change of the median edge: beyond it a series of growing cells would become ever coarser.
    """

    poor_angle: float = 20.0
    poor_share: float = 0.02
    edge_change: float = 1.2


@dataclass(frozen=True)
class TrackRules:
    """All rules of tracking, as they are saved with a track."""

    frames: FrameRules = field(default_factory=FrameRules)
    motion: MotionRules = field(default_factory=MotionRules)
    divisions: DivisionRules = field(default_factory=DivisionRules)
    alarms: AlarmRules = field(default_factory=AlarmRules)
    meshes: MeshRules = field(default_factory=MeshRules)


RULES = TrackRules()
