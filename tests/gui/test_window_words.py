"""What the window says: in its own words, and in colours that can be read."""

from types import SimpleNamespace

import numpy as np
import pytest
from qtpy.QtGui import QColor
from qtpy.QtWidgets import QAbstractSlider, QLabel, QVBoxLayout, QWidget

from napari_deltamic.common.words import joined, sentence
from napari_deltamic.errors import InputError
from napari_deltamic.gui.fit_widget import Column
from napari_deltamic.gui.record import Record
from napari_deltamic.gui.seeding.find_cells_button import look
from napari_deltamic.gui.viewing.colours import BY_VALUE, ByValue
from napari_deltamic.gui.widgets import VERDICTS, Note
from napari_deltamic.gui.window_words import for_window
from napari_deltamic.results.judged import told
from napari_deltamic.scene.effects import Effects

from .conftest import SIZE

NOTHING = SimpleNamespace(value=None)
NO_CAMERA = SimpleNamespace(gain=NOTHING, read_noise=NOTHING, offset=NOTHING)
GROUNDS = {"dark": "#23242b", "light": "#ebe7e6"}  # of napari's themes


def luminance(colour):
    parts = np.array(QColor(colour).getRgbF()[:3])
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return float(linear @ (0.2126, 0.7152, 0.0722))


def contrast(one, other):
    dark, light = sorted((luminance(one), luminance(other)))
    return (light + 0.05) / (dark + 0.05)


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("light next to it (--effects auto); uneven", "light next to it (see Corrections); uneven"),
        (
            "thick (--structure auto, --fit-psf)",
            "thick (see what is labelled, estimate the PSF from the image)",
        ),
        ("no place for it (--nonesuch)", "no place for it"),
        ("also (try --structure both)", "also (try both for 'what is labelled')"),
        ("no (try --nonesuch both); (try it)", "no; (try it)"),
        ("of about 2 um were found, 3 umbrellas", "of about 2 µm were found, 3 umbrellas"),
        ("1 per um^2, 2 um^3", "1 per µm², 2 µm³"),
        ("one of two (or both)", "one of two (or both)"),
    ],
)
def test_flags_are_named_as_the_fields_of_the_window(app, text, shown):
    assert for_window(text) == shown
    note = Note()
    note.say(text)
    assert note.text() == shown


def test_a_grade_is_told_in_voxels_where_their_size_is_not_known():
    verdict = SimpleNamespace(grade="good", usual_error_um=0.138, reasons=())
    known = SimpleNamespace(verdict=verdict, found=SimpleNamespace(explained=0.9))
    assert told(known).endswith("signal around them; they are off by about 138 nm.")
    assert told(known, "voxels").endswith("they are off by about 0.14 voxels.")


def test_a_question_has_no_full_stop():
    assert [sentence(text) for text in ("is it?", "it is", "")] == ["Is it?", "It is.", ""]


@pytest.mark.parametrize("verdict", sorted(VERDICTS))
def test_verdicts_can_be_read_on_dark_and_on_light(app, verdict):
    window = QWidget()
    note = Note(window)
    note.say("so it is", verdict)
    seen = set()
    for ground in (*GROUNDS.values(), GROUNDS["dark"]):
        window.setStyleSheet(f"QWidget {{ background-color: {ground}; }}")
        note.ensurePolished()
        app.processEvents()
        colour = note.styleSheet().rsplit("color: ", 1)[1].strip(" ;")
        assert contrast(colour, ground) >= 4.5
        seen.add(colour)
    assert len(seen) == 2
    note.say("nothing", "")
    assert "color" not in note.styleSheet()


def test_colours_by_a_number_are_seen_on_a_dark_image():
    colours = ByValue({1: 0.0, 2: 0.5, 3: 1.0}).rgba([1, 2, 3])
    for red, green, blue, _ in (*colours, *BY_VALUE.map(np.linspace(0, 1, 9))):
        assert contrast(QColor.fromRgbF(red, green, blue), "black") > 3


def test_a_part_that_was_just_shown_is_scrolled_to_with_what_follows_it(app, spin):
    inner = QWidget()
    above, part, below = (QLabel(text, inner) for text in ("above", "part", "below"))
    above.setFixedHeight(600)
    part.setFixedHeight(100)
    below.setFixedHeight(400)
    part.hide()
    below.hide()
    layout = QVBoxLayout(inner)
    for label in (above, part, below):
        layout.addWidget(label)
    outer = QWidget()
    outer.resize(300, 200)
    column = Column(inner, outer)
    column.resize(300, 200)
    outer.show()
    app.processEvents()
    part.show()
    column.show_part(part)
    bar = column.verticalScrollBar()
    spin(lambda: bar.value() >= 500, 5)
    # What follows may appear later.
    below.show()
    spin(lambda: bar.value() == part.y(), 5)
    below.hide()
    spin(lambda: bar.value() < part.y(), 5)
    column.show_part(part)
    spin(seconds=0.05, must=False)
    bar.triggerAction(QAbstractSlider.SliderAction.SliderToMinimum)
    below.show()
    spin(seconds=0.2, must=False)
    assert bar.value() == 0, "the user has scrolled"
    bar.setValue(40)
    part.hide()
    column.show_part(part)
    spin(seconds=0.1, must=False)
    assert bar.value() == 40, "there is nothing to see"
    outer.close()


def test_cells_without_a_number_are_as_grey_in_3d_as_in_2d():
    by = ByValue({1: 2.0, 2: np.nan, 4: 6.0})
    sides = np.array([[0, 1], [0, 2], [0, 3], [0, 4]])
    colormap, (low, high) = by.look()
    for chosen in ((), (1, 2)):
        drawn = colormap.map((by.surface_values(sides, chosen) - low) / (high - low))
        np.testing.assert_allclose(drawn[:, :3], by.rgba(sides[:, 1], chosen)[:, :3], atol=0.01)
        seen = np.isin(sides[:, 1], chosen) | (not chosen)
        np.testing.assert_allclose(drawn[seen, 3], 1)
        assert (drawn[~seen, 3] < 0.5).all()


def test_words_in_a_row_are_read_out():
    assert [joined("abc"[:n]) for n in range(4)] == ["", "a", "a and b", "a, b and c"]


def test_a_point_is_given_a_radius_where_the_window_has_one():
    text = "point 1 lies in no closed region of the image: give it a radius, or move it"
    assert for_window(text).endswith("image: set 'start from' to 'a sphere', or move it")


@pytest.mark.parametrize(
    ("image", "says"),
    [
        (np.ones((1, 20, 20)), "1 x 20 x 20 voxels.*open the whole stack"),
        (np.random.default_rng(0).random((9, 20, 20)) > 0.5, "use a mask as labels"),
    ],
)
def test_images_without_cells_are_refused_with_what_to_do(image, says):
    with pytest.raises(InputError, match=says):
        look(lambda: image, SIZE, None)


def test_a_turned_layer_is_refused_with_what_to_do(make_widget, with_image, pixels):
    widget = make_widget()
    with_image.add_image(pixels, name="turned", rotate=(0, 0, 30))
    chooser = widget.image.chooser
    chooser.setCurrentIndex(chooser.findText("turned"))
    assert widget.image.note.text().startswith("Layer 'turned' is rotated")
    assert "resample the image along its axes first" in widget.image.note.text()


@pytest.mark.parametrize(("box", "of"), [(None, "image"), (((0, 4),) * 3, "region")])
def test_a_region_has_a_border_of_its_own(box, of):
    record = Record(SimpleNamespace(frame=SimpleNamespace(box=box)), rows=[{"region": 1}])
    note = "the border of the image cuts it: what lies beyond is a guess"
    record.judge(SimpleNamespace(cells={1: {"note": note}}))
    assert record.rows[0]["note"].startswith(f"the border of the {of} cuts it")


def test_fields_of_a_psf_that_the_image_tells_say_so(make_widget):
    optics = make_widget().settings.optics
    assert "as wide as the blur of the image" in optics.width_note.text()
    optics.sigma._boxes[0].setValue(0.5)
    assert optics.width_note.text() == "Standard deviations along Z, Y and X, µm."


def test_no_other_corrections_are_spoken_of_where_none_is_ticked(make_widget):
    effects = make_widget().settings.effects
    nothing = {"evidence": (), "remarks": (), "recommended": (), "effects": Effects()}
    effects.show_found(SimpleNamespace(camera=NO_CAMERA, **nothing))
    assert effects.progress.text() == "the image gives no evidence for any corrections"
    effects.table.tick("halo")
    assert effects.progress.text() == "the image gives no evidence for other corrections"
