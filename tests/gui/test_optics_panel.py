"""The choice of the PSF: its fields, what is wrong with them, and how far it reaches."""

import numpy as np
import pytest

import napari_deltamic as nd
from napari_deltamic.fitting.job import optics_of, scene_with
from napari_deltamic.gui.document import Document
from napari_deltamic.gui.running.check_panel import LiveNumbers
from napari_deltamic.gui.settings.optics_panel import (
    GAUSSIAN,
    GIVEN,
    MEASURED,
    OBJECTIVE,
    OpticsPanel,
)
from napari_deltamic.images.stacks import write_image
from napari_deltamic.results.moved_numbers import MovedNumber
from napari_deltamic.runs.command import optics_flags
from napari_deltamic.runs.optics_settings import MicroscopeOptics, optics_from_values
from napari_deltamic.runs.settings import SceneSettings

from .conftest import SIZE
from .dialing import show_psf

WATER = {"kind": "microscope", "na": 0.8, "wavelength": 0.6, "immersion": "water"}


@pytest.fixture
def doc(app, with_image):
    doc = Document(with_image)
    yield doc
    doc.close()


@pytest.fixture
def panel(doc):
    panel = OpticsPanel(doc)
    panel.objective.show_settings(optics_from_values(WATER))
    return panel


@pytest.fixture
def bead(tmp_path):
    z, y, x = (np.arange(n) - n // 2 for n in (25, 25, 25))
    shape = np.exp(-0.5 * ((z[:, None, None] / 3) ** 2 + (y[:, None] / 2) ** 2 + (x / 2) ** 2))
    path = tmp_path / "bead.tif"
    write_image(path, (100 + 3000 * shape).astype(np.float32), (0.1, 0.1, 0.1))
    return path


def rows(panel):
    return {name for name, field in panel.objective.fields.items() if not field.isHidden()}


def test_only_the_fields_of_the_modality_are_there(panel):
    panel.kind.setCurrentText(OBJECTIVE)
    panel.objective.modality.setCurrentText("widefield")
    assert not {"pinhole", "excitation", "sheet", "depth"} & rows(panel)
    panel.objective.modality.setCurrentText("confocal")
    assert {"pinhole", "excitation"} <= rows(panel)
    panel.objective.modality.setCurrentText("light sheet")
    assert "sheet" in rows(panel)
    assert "pinhole" not in rows(panel)
    panel.objective.numbers["sample_index"].setValue(1.38)
    assert "depth" in rows(panel)
    assert "spherical" not in rows(panel)
    panel.objective.show_values(optics_from_values({**WATER, "model": "scalar"}))
    panel.objective._show_rows()
    assert "spherical" in rows(panel)


def test_a_negative_aberration_is_shown_and_belongs_to_its_model(panel):
    found = optics_from_values(
        {**WATER, "model": "scalar", "spherical": -0.5, "fitted": ("na", "spherical")}
    )
    panel.objective.show_settings(found)
    field = panel.objective.numbers["spherical"]
    assert field.value() == -0.5
    field.setValue(-0.4)
    assert panel.objective.settings().spherical == -0.4
    model = panel.objective.model
    model.setCurrentIndex(model.findData("vectorial"))
    assert panel.objective.settings().fitted == ("na",)
    assert panel.objective.settings().build().fitted == ("na",)


def test_the_widths_of_the_psf_are_told(panel, spin):
    assert panel.summary().startswith("Gaussian ")
    panel.kind.setCurrentText(OBJECTIVE)
    spin(lambda: not panel.background.busy)
    z, y, _ = optics_from_values(WATER).build().sigma_um
    assert f"{1000 * y:.0f} nm in the plane, {1000 * z:.0f} nm along z" in panel.width_note.text()
    assert panel.summary() == f"widefield NA 0.8, {z:.2f} (z), {y:.2f} (yx) µm"


@pytest.mark.parametrize(
    ("field", "value", "says"),
    [
        ("wavelength", 520, "wavelength 520 µm: did you mean 0.52?"),
        ("na", 1.4, "NA 1.4 must be below the refractive index of the immersion, 1.333"),
    ],
)
def test_an_error_is_told_in_words(panel, spin, field, value, says):
    panel.kind.setCurrentText(OBJECTIVE)
    panel.objective.numbers[field].setValue(value)
    spin(lambda: not panel.background.busy)
    assert panel.trouble.text() == says
    assert panel.summary().endswith("cannot be used")
    panel.objective.numbers[field].setValue(0.6)
    spin(lambda: not panel.background.busy)
    assert panel.trouble.text() == ""


def test_a_bead_in_a_file_is_the_psf(doc, panel, spin, bead):
    panel.kind.setCurrentText(MEASURED)
    with pytest.raises(nd.InputError, match="choose the image of a bead"):
        doc.settings.scene_settings()
    panel.measured.take_file(str(bead))
    spin(lambda: not panel.background.busy)
    assert doc.settings.psf.build().sigma_um == pytest.approx((0.3, 0.2, 0.2), rel=0.1)
    assert "measured, 0.3" in panel.summary()
    panel.measured.diameter.setValue(200)
    with pytest.raises(nd.InputError, match=r"did you mean 0\.2"):
        doc.settings.scene_settings()


def test_settings_come_back_as_they_were_shown(doc, panel):
    for settings in (
        optics_from_values({**WATER, "modality": "confocal", "pinhole": 1.2, "excitation": 0.55}),
        optics_from_values({**WATER, "modality": "light sheet", "sheet": 3.0}),
        optics_from_values({**WATER, "sample_index": 1.38, "depth": 12.0, "fitted": ("na",)}),
        optics_from_values(
            {"kind": "mixture", "sigmas": ((1, 1, 1), (2, 2, 2)), "masses": (1, 0.5)}
        ),
        None,
    ):
        show_psf(doc, settings)
        doc.settings.edit_psf(panel._settings)
        shown = doc.settings.psf
        if isinstance(settings, MicroscopeOptics):
            assert shown.build().described() == settings.build().described()
        else:
            assert shown == settings
    assert panel.kind.currentText() == GAUSSIAN


def test_one_that_has_no_fields_can_be_chosen_again(doc, panel):
    given = {"kind": "mixture", "sigmas": ((1, 1, 1), (2, 2, 2)), "masses": (1, 0.5)}
    show_psf(doc, optics_from_values(given))
    panel.kind.setCurrentText(GAUSSIAN)
    assert doc.settings.psf is None
    panel.kind.setCurrentText(GIVEN)
    assert doc.settings.psf == optics_from_values(given)
    assert panel.summary().startswith("mixture")


def test_a_command_gives_the_same_psf(capsys):
    settings = optics_from_values({**WATER, "modality": "confocal", "pinhole": 1.2})
    words = optics_flags(settings)
    assert {*zip(words[::2], words[1::2], strict=True)} >= {
        ("--na", "0.8"),
        ("--wavelength", "0.6"),
    }
    assert "--pinhole" in words
    # With a space before it, argparse would take it for a flag.
    aberrated = optics_from_values({**WATER, "model": "scalar", "spherical": -4e-5})
    assert "--spherical=-4e-05" in optics_flags(aberrated)
    with pytest.raises(nd.InputError, match=r"run\.toml"):
        optics_flags(optics_from_values({**WATER, "fitted": ("na", "wavelength")}))


def test_settings_follow_a_psf_that_was_fitted():
    scene = SceneSettings(voxel_size=SIZE, optics=optics_from_values(WATER))
    optics = optics_of(scene)
    moved = optics.with_parameters(optics.parameters() - 0.1)
    after = scene_with(scene, moved)
    assert after.optics.na == pytest.approx(float(moved.values["na"]))
    assert after.optics.na < 0.8
    np.testing.assert_allclose(optics_of(after).parameters(), moved.parameters())
    gaussian = scene_with(scene, nd.GaussianPSF((0.4, 0.2, 0.2)))
    assert (gaussian.sigma, gaussian.optics) == (pytest.approx((0.4, 0.2, 0.2)), None)


def test_a_fit_with_the_psf_of_an_objective_shows_its_numbers(seeded, spin):
    show_psf(seeded.doc, optics_from_values({**WATER, "na": 0.6}))
    seeded.settings.fit_psf.setChecked(True)
    seeded.settings.max_iterations.setValue(8)
    seeded.start()
    spin(lambda: not seeded.doc.run.running, seconds=60)
    state, job = seeded.doc.result.of_fit()
    assert type(state.optics).__name__ == "VectorialPSF"
    assert job.settings.scene.sigma is None
    [(name, start, now)] = seeded.running.numbers.texts()
    assert (name, start) == ("na", "0.6")
    na = next(p.value for p in state.optics.described() if p.name == "na")
    assert now == f"{na:.4g}"


def test_numbers_are_shown_with_their_units(app):
    numbers = LiveNumbers()
    assert numbers.isHidden()
    numbers.show_numbers([MovedNumber("sheet", "um", 2.0, 2.5), MovedNumber("na", "", None, 0.8)])
    assert numbers.texts() == [("sheet", "2", "2.5 um"), ("na", "-", "0.8")]
    numbers.show_numbers([])
    assert numbers.texts() == []


def test_another_kind_of_psf_is_for_the_next_run(seeded, spin, endless):
    seeded.start()
    spin(lambda: seeded.doc.run.state is not None and seeded.doc.link.mesh is not None)
    seeded.settings.optics.objective.show_settings(optics_from_values(WATER))
    seeded.settings.optics.kind.setCurrentText(OBJECTIVE)
    assert seeded.running.note.text() == "The new PSF applies to the next run."
    n = len(seeded.doc.run.history.loss)
    spin(lambda: len(seeded.doc.run.history.loss) > n + 2)
    assert isinstance(seeded.doc.run.state.optics, nd.GaussianPSF)
    assert seeded.doc.run.job.settings.scene.optics is None


def test_numbers_of_an_objective_go_into_a_fit_that_runs(seeded, spin, endless):
    show_psf(seeded.doc, optics_from_values(WATER))
    seeded.start()
    spin(lambda: seeded.doc.run.state is not None and seeded.doc.link.mesh is not None)
    seeded.settings.optics.objective.numbers["na"].setValue(0.9)
    spin(lambda: float(seeded.doc.run.state.optics.values["na"]) == 0.9)
    assert seeded.doc.run.job.settings.scene.optics.na == 0.9
    seeded.edits.undo()
    spin(lambda: float(seeded.doc.run.state.optics.values["na"]) == 0.8)
    assert seeded.doc.settings.scene_settings().optics.na == pytest.approx(0.8)
