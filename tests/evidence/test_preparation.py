"""What puts a fit together tells what it is at, and can be ended there."""

from functools import partial

import numpy as np
import pytest

from napari_deltamic.common.doing import doing, listening
from napari_deltamic.errors import Stopped
from napari_deltamic.evidence.put_together import put_together, start_of
from napari_deltamic.geometry import sphere
from napari_deltamic.geometry.labels.voxels import highest, voxel_labels
from napari_deltamic.optics import GaussianPSF
from napari_deltamic.runs.seeds import LabelSeeds
from napari_deltamic.runs.settings import FitSettings, RunSettings, SceneSettings
from napari_deltamic.scene import Grid, expected_image

SIZE, SHAPE = (0.3, 0.2, 0.2), (24, 40, 64)


@pytest.fixture(scope="module")
def scene():
    """Two cells, and labels of them that touch."""
    grid = Grid(SHAPE, SIZE)
    cells = [sphere((3.5, 4, x), (2.2, 2.3, 2.3), edge_length=0.5) for x in (4, 8.4)]
    image = sum(expected_image(c, grid, GaussianPSF((0.4, 0.25, 0.25)), 1e-2, 1, 0) for c in cells)
    one, two = (voxel_labels(c, SHAPE, SIZE) > 0 for c in cells)
    return np.asarray(image, np.float32), grid, np.where(one, 1, 2 * two)


def prepare(scene):
    image, grid, labels = scene
    settings = RunSettings(
        image="", seeds="", scene=SceneSettings(voxel_size=SIZE), fit=FitSettings()
    )
    return put_together(settings, image, grid, partial(start_of, LabelSeeds(labels)))


@pytest.mark.filterwarnings("ignore")
def test_each_stage_is_told(scene):
    told = []
    with listening(told.append):
        prepare(scene)
    doing("nobody hears this")
    words = [text for text in told if text]
    assert "making meshes of 2 cells" in words
    assert words[-1] == "finding which voxels belong to the cells"
    assert len(told) > 40  # each a place to stop at
    after = told[told.index("making meshes of 2 cells") :]
    assert after.index(words[-1]) > 10
    assert len(after) - after.index(words[-1]) > 5


@pytest.mark.filterwarnings("ignore")
def test_it_can_be_ended_anywhere(scene):
    told = []
    with listening(told.append):
        prepare(scene)
    for last in range(0, len(told), 7):
        heard = []

        def hear(text, heard=heard, last=last):
            if len(heard) == last:
                raise Stopped
            heard.append(text)

        with listening(hear), pytest.raises(Stopped):
            prepare(scene)
        assert len(heard) == last


def test_the_highest_value_of_each_part():
    parts = np.array([[0, 1, 1], [3, 3, 2]])
    values = np.array([[9, -2, -1], [4, 7, 5]], np.float32)
    assert highest(values, parts, 3).tolist() == [-1, 5, 7]
