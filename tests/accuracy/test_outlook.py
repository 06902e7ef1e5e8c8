"""What a fit would cost that could be started now, by the choice on the dial."""

import numpy as np

from napari_deltamic.accuracy import outlook
from napari_deltamic.fourier.cost import BUILT_IN
from napari_deltamic.runs.seeds import LabelSeeds
from napari_deltamic.runs.settings import FitSettings, SceneSettings
from napari_deltamic.scene import Grid

SIZE = (0.2, 0.2, 0.2)
IMAGE = np.random.default_rng(0).poisson(20, (24, 24, 40)).astype(np.float32)


def seconds(choice, monkeypatch, gap):
    labels = np.zeros(IMAGE.shape, np.int32)
    labels[6:18, 6:18, 6 : 20 - gap], labels[6:18, 6:18, 20:34] = 1, 2
    monkeypatch.setattr(outlook, "costs", lambda measure=False: BUILT_IN)
    given = SceneSettings(voxel_size=SIZE, sigma=SIZE), FitSettings(), LabelSeeds(labels), None
    found = outlook.outlook(outlook.SceneNow(choice, IMAGE, Grid(IMAGE.shape, SIZE), *given))
    return found.forecast.seconds


def test_quick_is_expected_to_try_no_other_neighbours(monkeypatch):
    touching, apart = (
        seconds("quick", monkeypatch, gap) / seconds("normal", monkeypatch, gap) for gap in (0, 3)
    )
    assert touching < 0.9 * apart
