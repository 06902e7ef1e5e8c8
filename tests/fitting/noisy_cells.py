"""Images of cells with the noise of counted photons: what tests of changing neighbours share."""

import numpy as np

from napari_deltamic import Grid, render


def photographed(truth, *others, voxel, optics, photons=40, draw=0):
    """Image of a surface, a twentieth of its peak everywhere, and a grid that holds all of them."""
    bounds = np.stack([mesh.bounds() for mesh in (truth, *others)])
    low, high = bounds[:, 0].min(0) - 0.6, bounds[:, 1].max(0) + 0.6
    shape = tuple(int(n) for n in np.ceil((high - low) / voxel) + 1)
    grid = Grid(shape, (voxel,) * 3, tuple(low))
    image = render(truth, grid, optics, 1e-4).numpy().astype(np.float64)
    image = photons * (0.05 + image.clip(0) / image.max())
    return np.random.default_rng(draw).poisson(image), grid


def events_of(states):
    """What happened in a fit."""
    return "; ".join(e for s in states for e in s.events)
