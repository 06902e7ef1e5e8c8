"""The picture of the PSF: that of the numbers shown, or of the fit; none while it is hidden."""

import numpy as np
import pytest

from napari_deltamic.gui.settings import optics_panel
from napari_deltamic.gui.settings.optics_panel import OBJECTIVE, _lean_in_words
from napari_deltamic.optics import GaussianPSF

from .dialing import show_psf


@pytest.fixture
def counted(monkeypatch):
    """What was computed."""
    made, find = [], optics_panel.psf_sections

    def sections(optics):
        made.append(optics)
        return find(optics)

    monkeypatch.setattr(optics_panel, "psf_sections", sections)
    return made


@pytest.fixture
def open_panel(seeded, spin):
    """A widget on the screen with its PSF panel unfolded."""
    seeded.show()
    seeded.settings.advanced.unfold()
    seeded.settings.psf_fold.unfold()
    return seeded


def picture(widget):
    return widget.settings.optics.picture


def extent(section):
    """Share of rows and columns above half of the largest value."""
    return (section.max(1) > 0.5).mean(), (section.max(0) > 0.5).mean()


def test_nothing_is_computed_while_the_panel_is_folded(seeded, spin, counted):
    seeded.show()
    show_psf(seeded.doc, sigma=(0.5, 0.3, 0.2))
    spin(seconds=0.5, must=False)
    assert counted == []
    assert picture(seeded).sections is None


def test_the_numbers_shown_are_drawn(open_panel, spin):
    spin(lambda: picture(open_panel).sections is not None)
    assert open_panel.settings.optics.found.text() == ""
    show_psf(open_panel.doc, sigma=(0.8, 0.2, 0.2))
    spin(lambda: picture(open_panel).sections.side == pytest.approx(5.6))
    tall, wide = extent(picture(open_panel).sections.xz)
    assert tall == pytest.approx(4 * wide, rel=0.4)
    image = picture(open_panel).grab().toImage()
    bright = image.pixelColor(optics_panel._SIDE // 2, optics_panel._SIDE // 2)
    assert bright.lightness() > 200


def test_many_changes_are_few_pictures(open_panel, spin, counted):
    for k in range(30):
        show_psf(open_panel.doc, sigma=(0.4 + 0.01 * k, 0.2, 0.2))
        spin(seconds=0.01, must=False)
    spin(lambda: not picture(open_panel)._background.busy)
    assert 1 <= len(counted) <= 4
    assert picture(open_panel).sections.side == pytest.approx(7 * 0.69)


def test_that_of_an_objective_is_drawn(open_panel, spin):
    optics = open_panel.settings.optics
    optics.kind.setCurrentText(OBJECTIVE)
    spin(lambda: not optics.background.busy and not picture(open_panel)._background.busy)
    assert picture(open_panel).sections is not None
    optics.objective.numbers["na"].setValue(9)
    spin(lambda: not optics.background.busy and not picture(open_panel)._background.busy)
    assert picture(open_panel).sections is None, "there is no such PSF"


def test_it_follows_the_fit(open_panel, spin, endless, counted):
    open_panel.settings.fit_psf.setChecked(True)
    open_panel.start()
    spin(lambda: open_panel.doc.run.state is not None and open_panel.doc.run.state.iteration > 5)
    spin(lambda: len(counted) > 1)
    open_panel.stop()
    spin(lambda: not open_panel.doc.run.running)
    spin(lambda: not picture(open_panel)._background.busy)
    np.testing.assert_allclose(
        picture(open_panel).sections.side, 7 * max(open_panel.doc.run.state.optics.sigma_um)
    )
    assert isinstance(counted[-1], GaussianPSF)
    z, y, _ = open_panel.doc.run.state.optics.sigma_um
    assert open_panel.settings.optics.found.text().startswith(
        f"That of the fit: {z:.2f} (z), {y:.2f}"
    )


def test_how_a_tilted_one_leans_is_said():
    c, s = np.cos(np.deg2rad(35)), np.sin(np.deg2rad(35))
    axes = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
    leaning = GaussianPSF(covariance=axes.T @ np.diag([0.6, 0.2, 0.2]) ** 2 @ axes)
    assert _lean_in_words(leaning) == ", leaning 35° towards -x"
    assert _lean_in_words(GaussianPSF((0.6, 0.2, 0.2))) == ""
