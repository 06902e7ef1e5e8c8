"""Settings that are changed while a fit runs."""

import numpy as np
import pytest

from napari_deltamic.errors import InputError
from napari_deltamic.fitting import Change, pending
from napari_deltamic.scene.effects import Effects

from .conftest import SIZE
from .interacting import notes, pause, vertices, went_on


def test_settings_are_taken_over(begun, spin):
    begun.settings.accuracy.setCurrentText("1e-4")
    begun.settings.accuracy.lineEdit().editingFinished.emit()
    spin(lambda: begun.doc.run.job.settings.fit.accuracy == 1e-4)
    spin(lambda: "accuracy" in begun.running.note.text())
    assert begun.running.note.text().startswith("accuracy 1e-4 from iteration")
    begun.settings.fit_psf.setChecked(True)
    begun.settings.fields["likelihood"].setCurrentText("the same everywhere")
    spin(lambda: "noise gaussian" in " ".join(notes(begun)))
    fit_settings = begun.doc.run.job.settings.fit
    assert (fit_settings.fit_psf, fit_settings.likelihood) == (True, "gaussian")
    begun.stop()
    spin(lambda: not begun.doc.run.running)
    assert begun.doc.result.job.settings.fit.accuracy == 1e-4


def test_the_psf_is_taken_over(begun, spin):
    begun.settings.sigma._boxes[0].setValue(0.5)
    spin(lambda: begun.doc.run.state.optics.sigma_um[0] == pytest.approx(0.5))
    spin(lambda: any(now.startswith("0.5 ") for _, _, now in begun.running.numbers.texts()))


@pytest.mark.slow
def test_a_psf_that_is_refused_holds_up_nothing_else_and_is_tried_again(begun, spin, monkeypatch):
    said = []
    begun.doc.noted.connect(said.append)
    sigma = begun.doc.run.state.optics.sigma_um[0]
    begun.settings.sigma._boxes[0].setValue(100)
    assert "standard deviation of 100 um" in said[-1]
    begun.settings.fit_psf.setChecked(True)
    assert "standard deviation of 100 um" in said[-1]  # it is shown still
    spin(lambda: begun.doc.run.job.settings.fit.fit_psf)
    assert begun.doc.run.state.optics.sigma_um[0] == pytest.approx(sigma, rel=0.5)
    begun.settings.fit_psf.setChecked(False)
    spin(lambda: not begun.doc.run.job.settings.fit.fit_psf)
    monkeypatch.setattr(pending, "check_psf", lambda optics, grid: None)
    begun.doc.settings.changed.emit(True)
    spin(lambda: begun.doc.run.state.optics.sigma_um[0] == pytest.approx(100))


def test_effects_are_taken_over_and_taken_back(begun, spin):
    panel = begun.settings
    begun.doc.settings.show_effects(Effects.of("attenuation"))
    begun.doc.settings.changed.emit(True)
    spin(lambda: begun.doc.run.state.effects.names == ("attenuation",))
    spin(lambda: "effects attenuation" in " ".join(notes(begun)))
    panel.effects.table.tick("pixel_integration")
    spin(lambda: begun.doc.run.state.effects.names == ("pixel_integration", "attenuation"))
    assert begun.doc.run.job.settings.scene.effects.names == ("pixel_integration", "attenuation")
    assert panel.effects_fold.title == "Corrections: voxel averaging, dimmer with depth"
    for left in (("attenuation",), ()):
        begun.edits.undo()
        spin(lambda left=left: begun.doc.run.state.effects.names == left)
        assert begun.doc.settings.scene_settings().effects.names == left


def test_what_cannot_be_used_is_told_and_the_fit_goes_on(begun, spin):
    begun.settings.accuracy.setCurrentText("much")
    begun.settings.accuracy.lineEdit().editingFinished.emit()
    assert "accuracy" in begun.running.note.text()
    n = len(begun.doc.run.history.loss)
    spin(lambda: len(begun.doc.run.history.loss) > n + 3)


def test_the_voxel_size_is_for_the_next_run(begun, spin):
    sigma, said = begun.doc.run.state.optics.sigma_um, begun.running.other_image
    begun.image.voxel_size._boxes[0].setValue(0.4)
    assert said.text().startswith("The fit goes on with voxels of 0.3 x 0.2 x 0.2 µm; the next")
    begun.image.voxel_size._boxes[0].setValue(SIZE[0])
    assert said.text() == ""
    assert begun.running.note.text() == ""
    begun.image.voxel_size._boxes[0].setValue(0.4)
    n = len(begun.doc.run.history.loss)
    spin(lambda: len(begun.doc.run.history.loss) > n + 3)
    assert begun.doc.run.state.optics.sigma_um == sigma


def test_another_image_is_for_the_next_run(begun, with_image, pixels, spin):
    begun.doc.image.choose(with_image.add_image(pixels.max() - pixels, name="other"))
    assert "goes on with 'cell'; the next run takes 'other'" in begun.running.note.text()
    n = len(begun.doc.run.history.loss)
    spin(lambda: len(begun.doc.run.history.loss) > n + 3)
    assert begun.doc.link.image_layer.name == "cell"


def test_a_tool_that_fails_says_why_and_keeps_the_verdict(ended, told):
    verdict = ended.running.verdict.text()
    edits = ended.edits
    ended.doc.guarded(lambda: edits.shift(np.full_like(vertices(ended), 500.0), "nudge"))
    assert "outside the image" in told[-1]
    assert "outside the image" in ended.running.note.text()
    assert ended.running.verdict.text() == verdict
    assert not edits.undo_note


def test_a_change_that_the_fit_refuses_does_not_end_it(begun, spin, told):
    away = begun.doc.link.mesh.translated((500, 500, 500))
    with pytest.raises(InputError, match="outside"):
        begun.edits.change(Change(mesh=away), "nudge")
    begun.doc.run.waiting.add(Change(mesh=away))  # past the first check
    spin(lambda: bool(told))
    assert "not changed" in told[-1]
    n = len(begun.doc.run.history.loss)
    spin(lambda: len(begun.doc.run.history.loss) > n + 3)


@pytest.fixture
def raised(monkeypatch):
    """What slots raise, which Qt tells to nobody else."""
    errors = []
    monkeypatch.setattr("sys.excepthook", lambda *error: errors.append(error))
    yield
    assert not errors


@pytest.mark.usefixtures("raised")
def test_a_fit_goes_on_though_the_panels_show_what_cannot_be_used(ended, with_image, spin):
    """Its image has been mirrored since: it has the voxels that it had."""
    with_image.layers["cell"].scale = np.multiply(SIZE, (1, -1, 1))
    history = ended.running.history
    history.slider.setValue(0)
    history.go_on_button.click()
    spin(went_on(ended))
    ended.doc.settings.changed.emit(True)
    assert "mirrored" in ended.running.note.text()
    with_image.layers["cell"].scale = SIZE
    ended.settings.fit_psf.setChecked(True)
    spin(lambda: ended.doc.run.job.settings.fit.fit_psf)
    assert "used from the next run on" not in ended.running.note.text()


@pytest.mark.usefixtures("raised")
def test_undo_though_the_panels_show_what_cannot_be_used(begun, with_image, spin):
    begun.settings.sigma._boxes[0].setValue(0.5)
    spin(lambda: begun.doc.run.state.optics.sigma_um[0] == pytest.approx(0.5))
    with_image.layers["cell"].scale = np.multiply(SIZE, (1, -1, 1))
    begun.edits.undo()
    spin(lambda: begun.doc.run.state.optics.sigma_um[0] != pytest.approx(0.5))


def test_a_dial_that_is_turned_and_turned_back_leaves_nothing_to_undo(begun, spin):
    accuracy = begun.settings.accuracy
    before = accuracy.currentText()
    pause(begun, spin)
    for text in ("1e-4", before):
        accuracy.setCurrentText(text)
        accuracy.lineEdit().editingFinished.emit()
        if text != before:
            assert begun.edits.undo_note.startswith("accuracy 1e-4")
    assert begun.edits.undo_note == ""
    assert not begun.running.history.undo_button.isEnabled()


def test_of_a_result_no_setting_is_undone(begun, spin):
    begun.settings.accuracy.setCurrentText("1e-4")
    begun.settings.accuracy.lineEdit().editingFinished.emit()
    assert begun.edits.undo_note
    spin(lambda: begun.doc.run.job.settings.fit.accuracy == 1e-4)
    begun.stop()
    spin(lambda: not begun.doc.running)
    assert begun.edits.undo_note == ""
    assert begun.settings.accuracy.currentText() == "1e-4"
