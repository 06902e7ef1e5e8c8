"""What a fit would cost that could be started now, by the choice on the dial."""

import numpy as np

from napari_deltamic.accuracy import outlook
from napari_deltamic.fourier.cost import BUILT_IN
from napari_deltamic.runs.seeds import LabelSeeds
from napari_deltamic.runs.settings import FitSettings, SceneSettings
from napari_deltamic.scene import Grid

SIZE = (0.2, 0.2, 0.2)
IMAGE = np.random.default_rng(0).poisson(20, (24, 24, 40)).astype(np.float32)


def looked_at(choice, monkeypatch, gap, image=IMAGE):
    labels = np.zeros(IMAGE.shape, np.int32)
    labels[6:18, 6:18, 6 : 20 - gap], labels[6:18, 6:18, 20:34] = 1, 2
    monkeypatch.setattr(outlook, "costs", lambda measure=False: BUILT_IN)
    given = SceneSettings(voxel_size=SIZE, sigma=SIZE), FitSettings(), LabelSeeds(labels), None
    return outlook.outlook(outlook.SceneNow(choice, image, Grid(image.shape, SIZE), *given))


def seconds(choice, monkeypatch, gap):
    return looked_at(choice, monkeypatch, gap).forecast.seconds


def test_quick_is_expected_to_try_no_other_neighbours(monkeypatch):
    touching, apart = (
        seconds("quick", monkeypatch, gap) / seconds("normal", monkeypatch, gap) for gap in (0, 3)
    )
    assert touching < 0.9 * apart


def test_a_length_stands_for_the_accuracy_that_a_fit_would_take(monkeypatch):
    image = np.zeros(IMAGE.shape, np.float32)
    image[6:18, 6:18, 6:34] = 1.0
    accuracy = {
        choice: looked_at(choice, monkeypatch, 3, image).accuracy
        for choice in ("3 nm", "normal", "200 nm")
    }
    assert accuracy["3 nm"] == accuracy["normal"] < accuracy["200 nm"]


def test_a_number_is_taken_as_it_is(monkeypatch):
    assert looked_at("0.005", monkeypatch, 3).accuracy == 0.005
