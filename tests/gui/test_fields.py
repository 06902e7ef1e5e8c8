"""The forms of the window are made of what settings say of themselves."""

import pytest
from qtpy.QtCore import QLocale, Qt
from qtpy.QtTest import QTest

from napari_deltamic.common.description import described
from napari_deltamic.errors import InputError
from napari_deltamic.gui.fields import Form, Number
from napari_deltamic.gui.settings.optics_panel import ObjectiveFields
from napari_deltamic.gui.window_words import for_window
from napari_deltamic.runs.optics_settings import MeasuredOptics, MicroscopeOptics
from napari_deltamic.runs.settings import FitSettings
from napari_deltamic.runs.track_settings import TrackSettings


def fields_of(widget):
    return {name: field for form in widget.settings.forms for name, field in form.fields.items()}


def test_every_setting_of_a_fit_is_in_the_window_once(make_widget):
    widget = make_widget()
    forms = widget.settings.forms
    names = [name for form in forms for name in form.fields]
    assert sorted([*names, "accuracy", "shape_error"]) == sorted(described(FitSettings))
    for name, found in described(FitSettings).items():
        if name not in ("accuracy", "shape_error"):
            assert for_window(found.sentence) in fields_of(widget)[name].toolTip()
            assert fields_of(widget)[name].accessibleName() == for_window(found.label)


@pytest.mark.parametrize("model", [FitSettings, MicroscopeOptics, MeasuredOptics, TrackSettings])
def test_a_form_has_a_field_for_each_setting(app, model):
    form = Form(model)
    assert set(form.fields) == set(described(model))
    titles = [form.form.itemAt(k) for k in range(form.form.count())]
    words = [item.widget().text() for item in titles if hasattr(item.widget(), "text")]
    for found in described(model).values():
        assert for_window(found.label) in words or found.title in words
    assert not [word for word in words if word.endswith(" um")]


def test_what_is_shown_stays_exact_until_it_is_edited(make_widget):
    widget = make_widget()
    odd = FitSettings(
        bending=1 / 3,
        tolerance=1e-12,
        levels=(10 / 3, 1.0),
        smoothing=0,
        device="cpu",
        density="smooth",
        remesh=False,
        max_iterations=2_000_000,
    )
    widget.doc.settings.show_fit(odd)
    assert widget.doc.settings.fit_settings() == odd
    fields_of(widget)["bending"].setValue(6)
    assert widget.doc.settings.fit_settings() == odd.model_copy(update={"bending": 6.0})


def test_numbers_are_typed_as_one_writes_them(make_widget):
    widget = make_widget()
    levels = fields_of(widget)["levels"]
    levels.setText("4, 2 1")
    levels.editingFinished.emit()
    assert widget.doc.settings.fit_settings().levels == (4, 2, 1)
    levels.setText("")
    levels.editingFinished.emit()
    assert widget.doc.settings.fit_settings().levels is None
    for wrong in ("1 2", "much"):
        levels.setText(wrong)
        levels.editingFinished.emit()
        with pytest.raises(InputError, match="levels"):
            widget.doc.settings.fit_settings()


def typed(box, text):
    """What a box holds after a text was typed into it, and what was said of that."""
    said = []
    box.refused.connect(said.append)
    box.selectAll()
    QTest.keyClicks(box.lineEdit(), text)
    QTest.keyClick(box, Qt.Key.Key_Return)
    return box.value(), "".join(said)


@pytest.mark.parametrize("language", ["C", "de_DE"])
@pytest.mark.parametrize(
    ("text", "value", "why"),
    [
        ("0,26", 0.26, ""),
        ("0.26", 0.26, ""),
        ("2.6e-1", 0.26, ""),
        ("-1", 0.2, "-1 is not between 0.001 and 1000"),
        ("1e9", 0.2, "1e9 is not between 0.001 and 1000"),
        ("290 nm", 0.2, "'290 nm' is no number"),
        ("1.234,5", 0.2, "'1.234,5' is no number"),
        ("", 0.2, ""),
    ],
)
def test_what_is_typed_is_taken_as_a_whole_or_not_at_all(make_widget, language, text, value, why):
    image = make_widget().image
    box, note = image.voxel_size._boxes[1], image.note.text()
    box.setLocale(QLocale(language))
    found, said = typed(box, text)
    assert found == value
    assert said.startswith(why)
    assert bool(said) == bool(why)
    assert image._doc.image.frame().voxel_size[1] == value
    assert image.note.text() == (f"{said[0].upper()}{said[1:]}." if why else note)
    QTest.keyClicks(box.lineEdit(), "0")
    assert image.note.text() == note


def test_other_numbers_are_taken_as_they_are_typed_too(app):
    number, whole = Number(), Number(whole=True)
    number.setSpecialValueText("automatic")
    assert typed(number, "0,5")[0] == 0.5
    value, why = typed(number, "0.000012")
    assert (value, "more than 4 decimals" in why) == (0.5, True)
    assert typed(number, "automatic") == (0, "")
    assert number.text() == "automatic"
    whole.setRange(0, 5000)
    for text, value in (("12", 12), ("1e3", 1000)):
        assert typed(whole, text) == (value, "")
    for text in ("2.5", "1,000", "many", "6000"):
        value, why = typed(whole, text)
        assert (value, text in why) == (1000, True)


def test_a_number_that_may_be_open_is_open_at_zero(app):
    fields = ObjectiveFields()
    fields.modality.setCurrentText("confocal")
    assert fields.value("excitation") is None
    assert fields.numbers["excitation"].text() == "automatic"
    fields.numbers["excitation"].setValue(0.488)
    assert fields.settings().excitation == 0.488


def test_what_a_fit_cannot_take_over_is_for_the_next_run(begun, spin):
    fields_of(begun)["device"].setCurrentText("CPU")
    assert begun.running.note.text() == "device: used from the next run on"
    fields_of(begun)["bending"].setValue(6)
    spin(lambda: begun.doc.run.job.settings.fit.bending == 6)
    assert begun.doc.run.job.settings.fit.device == "auto"
