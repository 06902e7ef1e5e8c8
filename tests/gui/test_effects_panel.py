"""Effects: what the image says about them, and how they reach a fit."""

import threading
from types import SimpleNamespace

import numpy as np
import pytest

from napari_deltamic.evidence import Evidence
from napari_deltamic.evidence.camera import Camera
from napari_deltamic.evidence.estimate import Finding, unknown
from napari_deltamic.gui.document import Document
from napari_deltamic.gui.settings import effects_panel
from napari_deltamic.gui.settings.effects_panel import EffectsPanel
from napari_deltamic.results.cell_columns import COLUMNS
from napari_deltamic.scene.effects import Attenuation, Effects

pytestmark = pytest.mark.usefixtures("soon", "judged")

FADING = Evidence(
    "attenuation", 12.3, 85.4, 0.4, 3.21, True, "z = 12.3; leaving it out would move it"
)
HALO = Evidence("halo", 0.7, 0.01, 0.0, 0.1, False, "z = 0.7: no more than chance")

EXPLAINED = [column.key for column in COLUMNS].index("explained")


def recommendation(*evidence):
    """What an engine would answer that recommends attenuation."""
    camera = Camera(Finding(2.0, 0.1, ""), unknown(""), unknown(""), unknown(""), None)
    effects = Effects.of(*(Attenuation(per_um=0.3) for e in evidence if e.recommended))
    names = tuple(e.name for e in evidence if e.recommended)
    return SimpleNamespace(
        effects=effects, evidence=evidence, camera=camera, remarks=("a remark",), recommended=names
    )


@pytest.fixture
def panel(app, viewer):
    return EffectsPanel(Document(viewer))


@pytest.fixture
def asked(monkeypatch):
    """Questions to the engine, which answers at once when it is let."""
    gate, calls = threading.Semaphore(0), []

    def recommend_for(job, fitted, progress):
        calls.append(fitted)
        progress("looking at attenuation")
        assert gate.acquire(timeout=20)
        progress("looking at halo")
        return recommendation(FADING, HALO)

    monkeypatch.setattr(effects_panel, "recommend_for", recommend_for)
    yield gate, calls
    gate.release(99)


def row_of(panel, name):
    """What the table shows of an effect, by the first words of the titles."""
    table, row = panel.table, panel.table.names().index(name)
    columns = range(table.columnCount())
    titles = [table.horizontalHeaderItem(c).text().partition("\n")[0] for c in columns]
    return dict(zip(titles, (table.item(row, c).text() for c in columns), strict=True))


def test_nothing_is_ticked_before_the_user_does(panel):
    assert panel.summary() == "none; check this image"
    panel.show_found(recommendation(HALO, FADING))
    assert panel._choice.effects == Effects()
    assert panel.summary() == "none; dimmer with depth recommended"
    row = row_of(panel, "attenuation")
    assert row == {
        "correction": "dimmer with depth",
        "evidence": "12.3",
        "shift": "85",
        "slower": "3.2",
    }
    assert row_of(panel, "pixel_integration")["evidence"] == ""
    assert "gain 2" in panel.remarks.text()


def test_a_recommendation_is_accepted_with_its_numbers(panel):
    told = []
    panel._choice.changed.connect(lambda: told.append(panel._choice.effects))
    panel.show_found(recommendation(FADING))
    panel.take_button.click()
    assert told == [Effects.of(Attenuation(per_um=0.3))]
    assert panel.summary() == "dimmer with depth"
    assert panel.take_button.isHidden()
    panel.table.tick("attenuation", False)
    assert panel._choice.effects == Effects()
    assert not panel.take_button.isHidden()


def test_the_reason_of_a_row_can_be_read(panel):
    panel.show_found(recommendation(FADING, HALO))
    panel.table.selectRow(0)
    assert panel.reason.text() == f"dimmer with depth: {FADING.reason}"
    assert HALO.reason in panel.table.item(1, 0).toolTip()


def test_effects_that_contradict_each_other_are_refused(panel):
    panel.table.tick("attenuation")
    panel.table.tick("bleaching")
    assert panel._choice.effects.names == ("attenuation",)
    assert "no image tells" in panel.reason.text()


def test_effects_without_a_row_get_one(panel):
    panel._choice.show_effects(Effects.of("camera"))
    assert "camera" in panel.table.names()
    assert panel._choice.effects.names == ("camera",)


def test_the_image_and_its_seeds_are_asked_in_the_background(seeded, spin, asked):
    gate, calls = asked
    view = seeded.settings.effects
    seeded.settings.max_iterations.setValue(5)
    view.button.click()
    assert seeded.settings.effects.button.busy
    assert view.button.text() == "Stop checking"
    spin(lambda: view.progress.text() == "looking at attenuation ...")
    gate.release()
    spin(lambda: not seeded.settings.effects.button.busy)
    assert view.found.recommended == ("attenuation",)
    assert seeded.settings.effects_fold.title == "Corrections: none; dimmer with depth recommended"
    assert calls[0].iteration == 5
    assert seeded.doc.settings.scene_settings().effects == Effects()
    seeded.settings.sigma._boxes[0].setValue(0.9)
    assert "check again" in view.progress.text()


@pytest.mark.slow
def test_a_fit_that_converged_is_not_done_again(seeded, spin, asked):
    gate, calls = asked
    gate.release()
    seeded.start()
    spin(lambda: not seeded.doc.run.running, seconds=60)
    state = seeded.doc.result.state
    assert state.converged
    seeded.settings.effects.button.click()
    spin(lambda: not seeded.settings.effects.button.busy)
    assert calls[0] is state
    seeded.settings.effects.table.tick("attenuation")
    seeded.settings.max_iterations.setValue(3)
    gate.release()
    seeded.settings.effects.button.click()
    spin(lambda: not seeded.settings.effects.button.busy, seconds=60)
    assert calls[1] is not state
    assert calls[1].effects.names == ("attenuation",)


def test_a_check_can_be_stopped(seeded, spin, asked):
    gate, _ = asked
    view = seeded.settings.effects
    seeded.settings.max_iterations.setValue(3)
    view.button.click()
    spin(lambda: view.progress.text() == "looking at attenuation ...")
    view.button.click()
    assert not seeded.settings.effects.button.busy
    assert view.progress.text() == "stopped"
    gate.release()
    spin(seconds=0.3, must=False)
    assert view.found is None


def test_without_seeds_it_says_what_is_missing(make_widget):
    widget = make_widget()
    widget.settings.effects.button.click()
    assert not widget.settings.effects.button.busy
    assert "Click cells" in widget.settings.effects.progress.text()


def test_an_accepted_effect_goes_into_the_fit_that_runs(seeded, spin, endless):
    seeded.start()
    spin(lambda: seeded.doc.run.state is not None and seeded.doc.link.mesh is not None)
    view = seeded.settings.effects
    assert not view.button.isEnabled()
    seeded.doc.settings.show_effects(Effects())
    view.found = recommendation(FADING)
    view.take_recommended()
    spin(lambda: seeded.doc.run.state.effects.names == ("attenuation",))
    spin(lambda: any(name == "attenuation: per um" for name, *_ in seeded.running.numbers.texts()))
    [(_, start, now)] = seeded.running.numbers.texts()
    assert start == "0.3"
    assert now.endswith(" 1/um")
    seeded.stop()
    spin(lambda: not seeded.doc.run.running)
    assert view.button.isEnabled()
    assert seeded.doc.result.job.settings.scene.effects.names == ("attenuation",)


def test_the_residual_is_in_standard_deviations_and_cells_are_judged(seeded, with_image, spin):
    table, n = seeded.results.table, EXPLAINED
    seeded.doc.look("residual")
    seeded.start()
    spin(lambda: not seeded.doc.run.running, seconds=60)
    assert table.isColumnHidden(n)
    spin(lambda: not table.isColumnHidden(n), seconds=60)
    layer = with_image.layers["cell: residual"]
    assert tuple(layer.contrast_limits) == (-5, 5)
    assert np.std(layer.data) == pytest.approx(1, abs=0.25)
    assert "explained" in table.as_text().splitlines()[0]
    assert table.item(0, n).text().endswith("%")
    assert layer.visible
    seeded.doc.look("image")
    assert not layer.visible


def test_every_fit_is_graded_without_being_asked(seeded, with_image, pixels, spin):
    seeded.start()
    spin(lambda: not seeded.doc.run.running, seconds=60)
    spin(lambda: seeded.running.grade.verdict != "", seconds=60)
    share = seeded.results.table.numbers("explained")[1]
    assert share > 0.75
    assert seeded.running.grade.text().startswith("Good: the cells explain")
    # Of another image nothing is known.
    own = seeded.doc.image.layer
    seeded.doc.image.choose(with_image.add_image(pixels[::-1].copy(), name="other"))
    assert seeded.running.grade.text() == ""
    seeded.doc.image.choose(own)
    assert seeded.running.grade.text().startswith("Good")


def test_a_wrong_shape_is_not_called_good(seeded, spin):
    """Far too few iterations: the fit ends, and its grade is not green."""
    seeded.settings.max_iterations.setValue(1)
    seeded.seeds.radius.setValue(0.7)
    seeded.start()
    spin(lambda: not seeded.doc.run.running, seconds=60)
    spin(lambda: seeded.running.grade.verdict != "", seconds=60)
    assert not seeded.running.grade.text().startswith("Good")
    assert "before you use them" in seeded.running.grade.text()
    # What may help is a button.
    seeded.settings.max_iterations.setValue(5)
    seeded.running.again.click()
    fit = seeded.doc.run_settings().fit
    assert (fit.fit_psf, fit.density) == (True, "smooth")
    spin(lambda: seeded.doc.result.job.settings.fit.fit_psf, seconds=60)
    spin(lambda: seeded.running.grade.verdict != "", seconds=60)
    assert seeded.running.again.isHidden()


def test_the_time_shown_is_checked(series_widget, viewer, series, spin):
    """Not that of the last fit."""
    series_widget.settings.max_iterations.setValue(2)
    series_widget.start()
    spin(lambda: not series_widget.doc.run.running)
    assert series_widget.settings.effects.asked()[0]().image.shape == series[0].shape
    np.testing.assert_array_equal(series_widget.settings.effects.asked()[0]().image, series[0])
    viewer.dims.set_current_step(0, 2)
    if viewer.layers["seeds"].ndim == 4:
        viewer.layers["seeds"].add((2, *viewer.layers["seeds"].data[0][-3:]))
    np.testing.assert_array_equal(series_widget.settings.effects.asked()[0]().image, series[2])


def test_an_image_is_read_in_the_thread(seeded, with_image, spin, asked):
    """Of a lazy one that takes long, nothing is read before the button is let go."""
    layer, main = with_image.layers["cell"], threading.get_ident()

    class Lazy:
        shape, dtype, ndim, size = layer.data.shape, layer.data.dtype, 3, layer.data.size

        def __init__(self, data):
            self.data, self.readers = data, []

        def __getitem__(self, index):
            return self.data[index]

        def __array__(self, *arguments, **options):
            self.readers.append(threading.get_ident())
            return np.asarray(self.data, *arguments)

    lazy = Lazy(layer.data)
    layer._data = lazy
    spin(lambda: not seeded.settings.forecast.background.busy)
    lazy.readers.clear()
    seeded.settings.effects.button.start()
    assert main not in lazy.readers
    asked[0].release(9)
    spin(lambda: not seeded.settings.effects.button.busy)
    assert lazy.readers
    assert main not in lazy.readers
