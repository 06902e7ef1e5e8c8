"""A second view: a layer with the same scene through another PSF."""

import shlex
from dataclasses import replace

import numpy as np
import pytest

from napari_deltamic.cli import main
from napari_deltamic.gui import image_source
from napari_deltamic.gui.results import session
from napari_deltamic.gui.running import worker
from napari_deltamic.results.session_file import load_session, save_session
from napari_deltamic.runs.settings import RunSettings

from .conftest import SHAPE, SIZE

PLACE = {"scale": SIZE, "translate": (1, 2, 3), "units": ("um",) * 3}
SIGMA = (0.2, 0.2, 0.3)

pytestmark = pytest.mark.usefixtures("soon")


@pytest.fixture
def second(with_image, pixels, seeded):
    """A layer, chosen as the second view of the widget."""
    layer = with_image.add_image(pixels[:, ::-1].copy(), name="side", **PLACE)
    fields = seeded.settings.effects.second
    fields.source.choose(layer)
    fields.source.resize(SIGMA)
    return fields


def done(widget):
    return lambda: widget.doc.run is not None and not widget.doc.run.running


def test_none_is_chosen_but_by_the_user(seeded, with_image, pixels):
    fields = seeded.settings.effects.second
    with_image.add_image(pixels, name="side", **PLACE)
    assert fields.source.layer is None
    assert fields.sigma.isHidden()
    names = [fields.chooser.itemText(k) for k in range(fields.chooser.count())]
    assert names == ["none", "side"], "the image itself is no second view"


def test_it_is_an_effect_of_the_run(seeded, second):
    view = seeded.doc.run_settings().scene.effects.second_view
    assert view is not None
    assert view.sigma == SIGMA
    assert "second view" in seeded.settings.effects_fold.title
    second.chooser.setCurrentIndex(0)
    assert seeded.doc.run_settings().scene.effects.second_view is None


def test_a_region_is_in_no_file(seeded, second, monkeypatch):
    monkeypatch.setattr(image_source, "file_of", lambda layer: (f"/data/{layer.name}.tif", None))
    view = seeded.doc.run_settings().scene.effects.second_view
    assert (seeded.doc.image.file()[0], view.image) == ("/data/cell.tif", "/data/side.tif")
    seeded.doc.image.take_region(((0, 20), (2, 23), (2, 24)))
    view = seeded.doc.run_settings().scene.effects.second_view
    assert (seeded.doc.image.file()[0], view.image) == ("", "")


@pytest.mark.usefixtures("judged")
def test_its_image_reaches_the_fit(seeded, second, spin, monkeypatch, pixels):
    jobs, start = [], worker.start

    def noted(job):
        jobs.append(job)
        return start(job)

    monkeypatch.setattr(worker, "start", noted)
    seeded.settings.max_iterations.setValue(3)
    seeded.start()
    spin(done(seeded))
    np.testing.assert_array_equal(jobs[0].second, pixels[:, ::-1])
    assert seeded.doc.run.state.effects.second_view is not None
    assert seeded.running.verdict.verdict != "failed"


@pytest.mark.parametrize(
    ("shape", "change", "says"),
    [
        ((5, 6, 7), {}, "has 5 x 6 x 7 voxels"),
        (SHAPE, {"scale": (0.2, 0.2, 0.2)}, "does not lie on the voxels"),
        (SHAPE, {"translate": (1, 2, 4)}, "does not lie on the voxels"),
        (SHAPE, {"rotate": 10}, "rotated"),
    ],
)
def test_a_layer_off_the_voxels_is_refused_in_words(seeded, with_image, told, shape, change, says):
    layer = with_image.add_image(np.random.default_rng(0).random(shape), **{**PLACE, **change})
    fields = seeded.settings.effects.second
    fields.source.choose(layer)
    assert says in fields.note.text()
    assert "resample it on the image's voxels first" in fields.note.text()
    seeded.start()
    assert says in told[-1]
    assert seeded.doc.run is None


def test_a_fit_under_way_keeps_the_second_view_that_it_has(seeded, second, spin, endless):
    seeded.start()
    spin(lambda: seeded.doc.link is not None and seeded.doc.link.mesh is not None)
    second.chooser.setCurrentIndex(0)
    assert "second view: used from the next run on" in seeded.running.note.text()
    seeded.settings.effects.table.tick("attenuation")
    spin(lambda: "attenuation" in seeded.doc.run.state.effects.names)
    assert seeded.doc.run.state.effects.second_view is not None
    seeded.stop()
    spin(done(seeded))


def test_the_command_repeats_it(seeded, second, spin, tmp_path, monkeypatch):
    texts = []
    dialog = "napari_deltamic.gui.results.more_actions.QFileDialog.getExistingDirectory"
    monkeypatch.setattr(dialog, staticmethod(lambda *a: str(tmp_path)))
    monkeypatch.setattr("napari_deltamic.gui.fit_widget.show_info", texts.append)
    seeded.settings.max_iterations.setValue(2)
    seeded.commands.copy()
    spin(lambda: texts)
    words = shlex.split(texts[-1].removeprefix("copied: "))
    assert str(tmp_path / "second.tif") in texts[-1]
    assert main(words[1:]) == 0
    settings = RunSettings.from_toml(tmp_path / "result" / "run.toml")
    assert settings.scene.effects.second_view.sigma == SIGMA


def test_a_session_keeps_it(seeded, second, spin, tmp_path, with_image, pixels):
    seeded.settings.max_iterations.setValue(2)
    seeded.start()
    spin(done(seeded))
    found, _ = session.capture(seeded.parts)
    save_session(tmp_path / "a.deltamic", found)
    second.chooser.setCurrentIndex(0)
    with_image.layers.remove("side")
    list(session.restore(seeded.parts, load_session(tmp_path / "a.deltamic")))
    assert second.source.layer is not None
    assert second.source.layer.name == "side"
    assert second.sigma.value() == SIGMA
    np.testing.assert_array_equal(second.source.pixels(), pixels[:, ::-1])
    np.testing.assert_array_equal(seeded.doc.result.job.second, pixels[:, ::-1])
    seeded.control.go_on_from(seeded.doc.result.state.mesh, seeded.doc.result.state.optics, None)
    spin(done(seeded))
    assert seeded.doc.run.state.effects.second_view is not None


def test_series_are_tracked_without_it(seeded, second, with_image, pixels, told):
    movie = with_image.add_image(np.stack([pixels, pixels]), scale=(1, *SIZE), name="movie")
    seeded.doc.image.choose(movie)
    side = with_image.add_image(pixels, scale=SIZE, name="other")
    second.source.choose(side)
    seeded.tracking.start()
    assert "a second view cannot be tracked" in told[-1]


def test_a_session_without_one_has_none(seeded, second, with_image):
    found, _ = session.capture(seeded.parts)
    effects = found.settings.scene.effects.without("second_view")
    scene = found.settings.scene.model_copy(update={"effects": effects})
    settings = found.settings.model_copy(update={"scene": scene})
    list(session.restore(seeded.parts, replace(found, settings=settings, second=None)))
    assert second.source.layer is None
    assert seeded.doc.run_settings().scene.effects.second_view is None


def test_what_is_wrong_is_no_more_said_once_it_is_right(seeded, second):
    second.source.layer.translate = (1, 2, 4)
    assert "does not lie on the voxels" in second.note.text()
    second.source.layer.translate = PLACE["translate"]
    assert second.note.text() == ""


def test_its_voxels_are_not_read_to_know_how_many_there_are(seeded, second, monkeypatch):
    monkeypatch.setattr(seeded.doc.image, "stack", lambda layer=None: pytest.fail("read"))
    assert second.source.view() is not None
