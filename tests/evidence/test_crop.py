"""The part of a scene that is judged."""

import numpy as np

from napari_deltamic import Grid, Mesh, render
from napari_deltamic.evidence.crop import crop_of
from napari_deltamic.evidence.modes import shape_modes
from napari_deltamic.geometry import mesh_from_labels, sphere
from napari_deltamic.optics import GaussianPSF

WIDTH = np.array([0.2, 0.2, 0.2])


def test_one_cell_is_taken_whole():
    grid = Grid((30, 40, 40), (0.2, 0.2, 0.2))
    ball = sphere((3, 4, 4), 1.5)
    part = crop_of(np.ones(grid.shape, bool), grid, ball, None, WIDTH)
    assert part.mesh is ball
    assert part.of == 1
    assert len(part.index) == np.prod(part.grid.shape) or len(part.index) > 1000


def test_a_few_of_many_cells_are_judged_around_the_middle():
    grid = Grid((20, 120, 120), (0.2, 0.2, 0.2))
    places = [(2, y, x) for y in (4, 12, 20) for x in (4, 12, 20)]
    mesh = Mesh.merge([sphere(p, 1.4, subdivisions=2) for p in places])
    part = crop_of(np.ones(grid.shape, bool), grid, mesh, None, WIDTH)
    assert part.of == 9
    assert len(part.cells) == 6
    assert 5 in part.cells  # in the middle
    origin = np.asarray(part.grid.origin)
    start = [s.start for s in part.box]
    assert np.allclose(origin, np.asarray(grid.voxel_size) * start)


def test_a_piece_shows_what_the_whole_image_shows_there():
    grid = Grid((16, 60, 60), (0.25, 0.25, 0.25))
    labels = np.zeros(grid.shape, np.uint16)
    for k in range(9):
        y, x = 6 + 16 * (k // 3), 6 + 16 * (k % 3)
        labels[4:12, y : y + 16, x : x + 16] = k + 1
    mesh = mesh_from_labels(labels, grid.voxel_size)
    optics = GaussianPSF((0.2, 0.2, 0.2))
    part = crop_of(np.ones(grid.shape, bool), grid, mesh, None, WIDTH)
    whole = render(mesh, grid, optics, 1e-4).numpy()[part.box].reshape(-1)[part.index]
    piece = render(part.mesh, part.grid, optics, 1e-4, density=part.density).numpy()
    piece = piece.reshape(-1)[part.index]
    assert np.linalg.norm(piece - whole) < 5e-3 * np.linalg.norm(whole)


def test_a_cell_beyond_the_image_is_not_judged():
    grid = Grid((30, 40, 40), (0.2, 0.2, 0.2))
    ball = sphere((3, 4, 4), 1.5)
    mesh = Mesh.merge([ball, ball.translated((0, 0, 30))])
    part = crop_of(np.ones(grid.shape, bool), grid, mesh, None, WIDTH)
    assert part.cells.tolist() == [1]
    assert part.of == 2
    assert len(shape_modes(part.mesh, part.cells)) > 0
    assert len(shape_modes(part.mesh, np.zeros(0, int))) == 0
