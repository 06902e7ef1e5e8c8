"""What the tests of the accuracy dial, and of other settings, share."""

from napari_deltamic.runs.settings import SceneSettings

from .conftest import SIZE


def settled(widget):
    later, forecast = widget.seeds._later, widget.settings.forecast.background
    return lambda: not (later.busy or widget.seeds.preview.background.busy or forecast.busy)


def running(widget):
    return widget.doc.run is not None and widget.doc.run.running


def show_psf(doc, optics=None, sigma=None):
    """Choose a PSF, as a session does."""
    effects = doc.settings.effects
    scene = SceneSettings(voxel_size=SIZE, sigma=sigma, optics=optics, effects=effects)
    doc.settings.show_scene(scene)
