"""Images of a cell and fits of them, made once."""

import pytest
from evidence_scenes import fitted, photons

from napari_deltamic.scene.effects import Effects, Halo


@pytest.fixture(scope="session")
def plain():
    """An image without effects, and a fit of it."""
    image = photons()
    return image, fitted(image)


@pytest.fixture(scope="session")
def hazy():
    """An image with a halo, and a fit without one."""
    image = photons(Effects.of(Halo(fraction=0.3, width=1.0)), seed=1)
    return image, fitted(image)
