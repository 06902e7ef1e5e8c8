"""Small series of images whose truth is known: what the tests of tracking share."""

import numpy as np
import trimesh

from napari_deltamic import GaussianPSF, Grid, render
from napari_deltamic.geometry import sphere
from napari_deltamic.geometry.foam import foam
from napari_deltamic.runs.settings import NEAR_LEVELS, FitSettings
from napari_deltamic.tracking import track

VOXEL = 0.25
GRID = Grid((22, 26, 26), (VOXEL,) * 3)
OPTICS = GaussianPSF(1.3 * VOXEL)
MIDDLE = VOXEL * np.array([10.5, 12.5, 12.5])
RADIUS = 6.5 * VOXEL
EDGE = 2.5 * VOXEL
NEAR = FitSettings(levels=NEAR_LEVELS, accuracy=2e-2, collisions=False)


def photographed(mesh, seed=0, peak=40.0):
    """An image of a mesh with the noise of counted photons, over a background of 2."""
    clean = render(mesh, GRID, OPTICS, 1e-3).numpy().clip(0)
    return np.random.default_rng(seed).poisson(2 + peak * clean / clean.max()).astype(np.float32)


def ball(shift=(0, 0, 0), radius=RADIUS):
    """One cell, shifted by so many voxels."""
    return sphere(MIDDLE + VOXEL * np.asarray(shift, float), radius, edge_length=EDGE)


def pair(apart, angle=0.6, radius=0.85 * RADIUS):
    """Two cells that share a wall, so many voxels apart; the wall is askew."""
    along = VOXEL * apart / 2 * np.array([0, np.cos(angle), np.sin(angle)])
    return foam(np.array([MIDDLE - along, MIDDLE + along]), np.full(2, radius), EDGE)


def drifting(n, step=(0, 0.6, -0.4)):
    """One cell that drifts by so many voxels a frame."""
    return [photographed(ball(np.multiply(t, step)), seed=t) for t in range(n)]


def tracked(images, mesh=None, **options):
    """The results of all frames."""
    states = track(images, GRID, ball() if mesh is None else mesh, OPTICS, NEAR, **options)
    return [state.done for state in states if state.done is not None]


def center(mesh, region=1):
    """Centre of the volume of a region, um: vertices may lie denser on one side."""
    surface = mesh.region_surface(region)
    return trimesh.Trimesh(surface.vertices_numpy(), surface.faces, process=False).center_mass
