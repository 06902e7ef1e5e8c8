"""Scenes that strain the transforms, on a GPU: the bars are those of the CPU."""

import pytest
from scene_errors import ACCURACIES, scene_errors, scenes


@pytest.mark.parametrize("method", ["particle-mesh", "closed form"])
@pytest.mark.parametrize("accuracy", ACCURACIES)
@pytest.mark.parametrize("name", scenes())
def test_image_and_gradient_keep_to_the_accuracy(gpu, name, accuracy, method):
    image, gradient = scene_errors(name, accuracy, method, gpu)
    assert 0 < image < accuracy
    assert 0 < gradient < accuracy
