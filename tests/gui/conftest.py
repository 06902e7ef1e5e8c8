"""A viewer without a display, and a small image to fit."""

import gc
import importlib
import os
import threading
import time
import warnings
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

# Set before Qt is loaded; the tests of real windows ask for a display of their own.
if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
    os.environ["QT_QPA_PLATFORM"] = "offscreen"

with warnings.catch_warnings():
    # What napari's own dependencies deprecate is not for us to mend.
    warnings.simplefilter("ignore")
    pytest.importorskip("napari")
    pytest.importorskip("qtpy")
    import napari
    import napari.components
    import napari.layers
    import napari.qt
    import napari.utils.notifications
    import napari.viewer
    from qtpy.QtWidgets import QApplication

    from napari_deltamic.gui import calm, fit_widget
    from napari_deltamic.gui.document import Document
    from napari_deltamic.gui.running import run_control, worker
    from napari_deltamic.gui.seeding import preview, seeds_panel
    from napari_deltamic.gui.settings import accuracy_forecast
    from napari_deltamic.results import judged as judged_results

import napari_deltamic as nd
from napari_deltamic.accuracy import machine_costs
from napari_deltamic.common.cache_folder import CACHE_VARIABLE
from napari_deltamic.fitting import fit
from napari_deltamic.fourier.cost import BUILT_IN
from napari_deltamic.geometry import sphere
from napari_deltamic.results import report
from napari_deltamic.results.judged import compared
from napari_deltamic.tracking import track

SIZE = (0.3, 0.2, 0.2)
SHAPE = (20, 24, 24)
CENTER = (2.9, 2.3, 2.3)
STEP = np.array([0.0, 0.1, -0.1])  # um a frame, in the series


@pytest.fixture(autouse=True)
def costs(monkeypatch, tmp_path):
    """No test waits until the machine has been measured, or learns how long fits take here."""
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "cache"))
    found = replace(BUILT_IN, measured=True)
    monkeypatch.setattr(machine_costs, "calibrate", lambda: found)
    return found


@pytest.fixture(scope="module", autouse=True)
def frozen():
    """What is there before a file of tests (modules, mostly) is not looked through after each.

    Frozen after a test, its viewer and widgets would be as well, and never be freed.
    """
    gc.collect()
    gc.freeze()


@pytest.fixture(autouse=True)
def quick(monkeypatch, request, a_picture):
    """What takes long after each fit, and few tests ask for, is left out."""
    if "judged" not in request.fixturenames:
        monkeypatch.setattr(run_control, "judge", _only_rendered)
        monkeypatch.setattr(judged_results, "judged_frame", lambda done, *of_fit: done)
        monkeypatch.setattr(report, "picture_png", lambda *given: a_picture)
    if "thawed" not in request.fixturenames:
        # To count all that is frozen here takes long.
        monkeypatch.setattr(calm, "gc", SimpleNamespace(get_freeze_count=lambda: 1))


@pytest.fixture
def judged():
    """For tests of how good the end of a fit is said to be."""


def _only_rendered(state, job, spread):
    return compared(state.rendered(), job, spread)


@pytest.fixture(scope="session")
def app():
    """The Qt application."""
    return QApplication.instance() or QApplication([])


@pytest.fixture(scope="session")
def pixels():
    """A noisy image of one cell."""
    grid = nd.Grid(SHAPE, SIZE)
    truth = sphere(CENTER, (1.2, 1.1, 1.1), edge_length=0.3)
    image = nd.render(truth, grid, nd.GaussianPSF((0.36, 0.24, 0.24))).numpy()
    return np.random.default_rng(0).poisson(100 + 400 * image / image.max()).astype(np.float32)


@pytest.fixture
def viewer(app):
    """A viewer's model: no window, no canvas."""
    return napari.components.ViewerModel()


@pytest.fixture
def with_image(viewer, pixels):
    """The viewer with the image, at a place of its own."""
    viewer.add_image(pixels, scale=SIZE, translate=(1, 2, 3), units=("um",) * 3, name="cell")
    return viewer


@pytest.fixture
def spin(app):
    """Let events happen until something is true."""

    def spin(until=lambda: False, seconds=60.0, *, must=True):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            app.processEvents()
            if until():
                return
            time.sleep(0.002)
        assert not must, "it did not happen in time"

    return spin


@pytest.fixture
def make_widget(app, with_image, spin):
    """Widgets for the viewer with the image; whatever they run ends with the test."""
    made = []

    def make():
        widget = fit_widget.FitWidget(with_image)
        made.append(widget)
        return widget

    yield make
    for widget in made:
        widget.close_links()
    made.clear()
    spin(seconds=0.05, must=False)
    gc.collect()


@pytest.fixture
def seeded(make_widget, with_image):
    """A widget with a seed placed in the cell as a small sphere; little is fitted besides."""
    widget = make_widget()
    widget.settings.fit_psf.setChecked(False)
    widget.settings.density.setCurrentText("uniform")
    widget.seeds.place.click()
    with_image.layers["seeds"].add(CENTER)
    widget.seeds.shape.setCurrentText("a sphere")
    widget.seeds.radius.setValue(0.9)
    return widget


@pytest.fixture
def endless(monkeypatch):
    """Fits that go on until they are stopped; a change may be sent into them."""

    def states(job):
        states = fit(
            job.image,
            job.grid,
            job.mesh,
            job.optics,
            settings=job.settings.fit,
            effects=job.settings.scene.effects,
            second=job.second,
        )
        change = None
        while True:
            state = states.send(change)
            change = yield state
            if change is None and state.message:
                change = nd.Change()  # nothing, but a fit that has ended goes on

    monkeypatch.setattr(worker, "start", states)


@pytest.fixture
def soon(monkeypatch):
    """Nothing waits for changes that may follow."""
    monkeypatch.setattr(accuracy_forecast, "WAIT", 10)
    monkeypatch.setattr(seeds_panel, "_WAIT", 5)
    monkeypatch.setattr(preview, "WAIT", 5)


@pytest.fixture
def told(monkeypatch):
    """What the widget tells the user in notifications."""
    texts = []
    for name in ("show_info", "show_warning"):
        monkeypatch.setattr(fit_widget, name, texts.append)
    return texts


@pytest.fixture
def window(app, monkeypatch):
    """A real viewer, shown, where there is a display; without one only its canvas is missing."""
    if os.environ.get("QT_QPA_PLATFORM") == "offscreen":
        _without_gl(monkeypatch)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        viewer = napari.Viewer(show=os.environ.get("QT_QPA_PLATFORM") != "offscreen")
    yield viewer
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        _close(viewer)
    app.processEvents()


def _close(viewer):
    try:
        viewer.close()
    except RuntimeError:  # closed by the test
        return


def _without_gl(monkeypatch):
    """Image layers ask GL for its limits, which crashes without a display. Private names."""
    for module, name, value in (
        ("napari._vispy.layers.image", "get_gl_extensions", ""),
        ("napari._vispy.canvas", "get_max_texture_sizes", (2048, 2048)),
        ("napari._vispy.layers.base", "get_max_texture_sizes", (2048, 2048)),
        ("napari._vispy.layers.image", "get_max_texture_sizes", (2048, 2048)),
        ("napari._vispy.layers.labels", "get_max_texture_sizes", (2048, 2048)),
    ):
        found = importlib.import_module(module)
        if hasattr(found, name):
            monkeypatch.setattr(found, name, lambda value=value: value)


@pytest.fixture
def panel(app, with_image):
    """The panel of the cells, without the rest of the widget."""
    doc = Document(with_image)
    yield seeds_panel.SeedsPanel(doc)
    doc.close()


@pytest.fixture
def ball_labels():
    """A ball in a corner of the image, as label 3."""
    place = np.stack(np.indices(SHAPE), axis=-1) * SIZE
    return np.where(np.linalg.norm(place - (1.5, 1.2, 1.2), axis=-1) < 0.8, 3, 0)


@pytest.fixture
def held(monkeypatch):
    """Previews that do not end before they are let go."""
    gate, calls = threading.Event(), []
    find = preview.find

    def slow(*arguments):
        calls.append(len(arguments[0]))
        assert gate.wait(20)
        return find(*arguments)

    monkeypatch.setattr(preview, "find", slow)
    yield gate, calls
    gate.set()


@pytest.fixture(scope="session")
def series():
    """Four frames of a cell that drifts."""
    grid, optics = nd.Grid(SHAPE, SIZE), nd.GaussianPSF((0.36, 0.24, 0.24))
    rng, frames = np.random.default_rng(0), []
    for t in range(4):
        cell = sphere(CENTER + t * STEP, (1.2, 1.1, 1.1), edge_length=0.3)
        image = nd.render(cell, grid, optics).numpy()
        frames.append(rng.poisson(100 + 400 * image / image.max()))
    return np.array(frames, np.float32)


@pytest.fixture
def series_widget(app, viewer, series, spin):
    """A widget with the series, and a sphere around a point as the seed."""
    viewer.add_image(
        series, scale=(5, *SIZE), translate=(0, 1, 2, 3), units=("s", *("um",) * 3), name="movie"
    )
    viewer.dims.set_current_step(0, 0)
    widget = fit_widget.FitWidget(viewer)
    widget.seeds.place.click()
    seeds = viewer.layers["seeds"]
    seeds.add(CENTER if seeds.ndim == 3 else (0, *CENTER))
    widget.seeds.shape.setCurrentText("a sphere")
    widget.seeds.radius.setValue(0.9)
    yield widget
    widget.close_links()
    spin(seconds=0.05, must=False)
    gc.collect()


@pytest.fixture
def slow_tracking(monkeypatch):
    """Tracking that lets go of every frame only when it is told to."""
    gate = []

    def states(images, *arguments, **options):
        for state in track(images, *arguments, **options):
            while state.done is not None and state.done.frame >= len(gate):
                yield replace(state, done=None)
            yield state

    monkeypatch.setattr(judged_results, "track", states)
    return gate


@pytest.fixture
def begun(seeded, with_image, spin, endless):
    """A widget with a fit that runs, and is shown."""
    with_image.dims.set_point(0, CENTER[0] + 1)
    seeded.start()
    spin(lambda: seeded.doc.link.mesh is not None and len(seeded.doc.run.history.loss) > 3)
    return seeded


@pytest.fixture
def ended(begun, spin):
    begun.stop()
    spin(lambda: not begun.doc.run.running)
    return begun


@pytest.fixture
def reopened(app, spin):
    """Opens a session in a widget of its own, in an empty viewer."""
    made = []

    def reopen(path):
        viewer = napari.components.ViewerModel()
        widget = fit_widget.FitWidget(viewer)
        made.append(widget)
        widget.sessions.open(str(path))
        spin(lambda: not widget.sessions.busy and len(viewer.layers) > 0)
        return viewer, widget

    yield reopen
    for widget in made:
        widget.close_links()
    made.clear()


def pytest_sessionfinish():
    """What is frozen would be called leaked at the end."""
    gc.unfreeze()
