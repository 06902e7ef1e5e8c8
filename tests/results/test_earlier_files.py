"""Files of earlier versions, in which light inside cells was the effect ``bulk``.

They were written by such a version: a scene of two cells of which one shines half as much from
inside, with its image, and a fit of 30 iterations to an image of one cell, whose start, settings,
15th iteration and end are kept.
"""

import json
from pathlib import Path

import numpy as np
import pytest

import napari_deltamic as nd
from napari_deltamic.errors import InputError
from napari_deltamic.fitting.state import load_checkpoint
from napari_deltamic.results.scene_file import load_scene
from napari_deltamic.results.session_file import load_session
from napari_deltamic.runs.settings import RunSettings, validated
from napari_deltamic.runs.track_run import TrackRun
from napari_deltamic.scene import Grid, Solid, render_scene
from napari_deltamic.scene.effects import Effects
from napari_deltamic.scene.light import structure_of

FOLDER = Path(__file__).with_name("earlier")
GRID = Grid((10, 12, 14), (0.25, 0.2, 0.2))  # of the scene
ENDED = 0.782772452978629  # the density inside when the fit ended


def test_a_scene_shines_as_it_did():
    scene = load_scene(FOLDER / "scene.zip")
    assert scene.effects.names == ("attenuation",)
    assert [isinstance(s, Solid) for s in scene.structures] == [False, True]
    found, then = render_scene(scene, GRID, 1e-4).numpy(), np.load(FOLDER / "scene.npy")
    assert np.abs(found - then).max() < 1e-3 * then.max()


def test_a_session_shows_what_it_showed():
    result = load_session(FOLDER / "session.deltamic").result
    assert result.settings.fit.structure == "both"
    assert result.settings.scene.effects.names == ("bleaching",)
    assert result.state.effects.names == ("bleaching",)
    assert structure_of(result.state.light) == "both"
    assert result.state.light.interior == pytest.approx(ENDED)
    found, then = result.state.rendered(), np.load(FOLDER / "rendered.npy")
    within = result.settings.fit.image_accuracy
    assert np.linalg.norm(found - then) < within * np.linalg.norm(then - then.min())


def test_the_settings_of_a_run_say_that_insides_may_shine():
    found = RunSettings.from_toml(FOLDER / "run.toml")
    assert (found.fit.structure, found.fit.levels) == ("both", (1.5, 1.0))
    assert found.scene.effects.names == ("bleaching",)
    assert RunSettings.from_toml(FOLDER / "run.toml").to_toml() == found.to_toml()
    assert "bulk" not in found.to_toml()


def test_names_alone_are_read_as_well():
    values = {"image": "", "seeds": "", "scene": {"voxel_size": (1, 1, 1), "effects": ["bulk"]}}
    for model in (RunSettings, TrackRun):
        found = validated(model, values)
        assert found.fit.structure == "both"
        assert found.scene.effects == Effects()


def test_a_fit_goes_on_from_a_checkpoint():
    settings = RunSettings.from_toml(FOLDER / "run.toml")
    image = np.load(FOLDER / "image.npy")
    before = load_session(FOLDER / "session.deltamic").result
    optics = nd.GaussianPSF(settings.scene.sigma)
    grid = Grid(image.shape, settings.scene.voxel_size)
    given = image, grid, before.start, optics
    options = {"settings": settings.fit, "effects": settings.scene.effects}
    kept = load_checkpoint(FOLDER / "checkpoint.npz")
    states = list(nd.fit(*given, **options, resume=FOLDER / "checkpoint.npz"))
    assert states[0].iteration == json.loads(str(kept["run"]))["iteration"] + 1 == 14
    np.testing.assert_array_equal(states[0].mesh.vertices_numpy(), kept["vertices"])
    assert not np.allclose(kept["vertices"], before.start.vertices_numpy(), atol=0.1)
    last = states[-1]
    assert last.light.interior == pytest.approx(ENDED, rel=0.05)
    assert last.mesh.volumes()[1] == pytest.approx(before.state.mesh.volumes()[1], rel=0.01)


def test_the_command_line_says_what_is_there_instead():
    for make in (lambda: Effects.from_text("bulk=0.1"), lambda: Effects.of("bulk")):
        with pytest.raises(InputError, match=r"no effect: .*--structure both"):
            make()
