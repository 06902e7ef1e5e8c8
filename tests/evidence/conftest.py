"""Images of a cell and fits of them, made once."""

import pytest
from evidence_scenes import fitted, photons

from napari_deltamic.scene.effects import Bulk, Effects


@pytest.fixture(scope="session")
def plain():
    """An image without effects, and a fit of it."""
    image = photons()
    return image, fitted(image)


@pytest.fixture(scope="session")
def filled():
    """An image of a cell whose inside shines, and a fit without bulk."""
    image = photons(Effects.of(Bulk(density=0.15)), seed=1)
    return image, fitted(image)
