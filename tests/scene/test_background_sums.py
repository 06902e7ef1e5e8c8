"""What a background adds for each number, summed with an image over its voxels."""

import torch

from napari_deltamic.scene import Grid
from napari_deltamic.scene.effects import Background


def test_sums_are_those_of_the_image_of_each_number():
    frame = Grid((6, 9, 11), (0.5, 0.2, 0.2))
    grid = Grid((5, 7, 8), (0.5, 0.2, 0.2), (0.5, 0.4, 0.2))  # a part of it
    image = torch.randn(grid.shape, generator=torch.Generator().manual_seed(0))
    background = Background(order=3)
    sums = background.summed(image, grid, frame)
    assert len(sums) == len(background.coefficients)
    for k, found in enumerate(sums):
        only = tuple(float(n == k) for n in range(len(sums)))
        added = Background(order=3, coefficients=only).offset(grid, frame)
        assert torch.isclose(found, (added * image).sum(), rtol=1e-6, atol=1e-9)


def test_offsets_add_up():
    grid = Grid((4, 5, 6), (0.5, 0.2, 0.2))
    numbers = torch.randn(2, 9, generator=torch.Generator().manual_seed(0)).tolist()
    one, other = (Background(order=2, coefficients=tuple(own)) for own in numbers)
    both = one.with_parameters(one.parameters() + other.parameters())
    torch.testing.assert_close(
        both.offset(grid, grid), one.offset(grid, grid) + other.offset(grid, grid)
    )
