"""A fit that gets other triangles on the way: all that hangs on its vertices goes along."""

import time

import numpy as np
import pytest

from napari_deltamic.fitting import Change, fit
from napari_deltamic.fitting.pending import Waiting
from napari_deltamic.geometry import sphere
from napari_deltamic.geometry.carry import carried, same_triangles
from napari_deltamic.geometry.remeshing import can_remesh
from napari_deltamic.geometry.remeshing import remesh as remeshed
from napari_deltamic.gui.running import worker
from napari_deltamic.results.session_file import load_session, save_session

from .conftest import CENTER
from .interacting import pause, went_on
from .mouse import Mouse

pytestmark = pytest.mark.skipif(not can_remesh(), reason="the compiled extension is missing")
START = sphere(CENTER, 0.9, subdivisions=3)
ALONG_X = np.array([0.0, 0.0, 1.0])


@pytest.fixture
def gate(monkeypatch):
    """Fits that never end, and are remeshed (as the engine does it) when ``gate`` is emptied."""
    closed = ["closed"]

    def renewed(state):
        """The state with other triangles: however far the fit has come, edges are too long."""
        mesh = state.mesh
        corners = mesh.vertices_numpy()[mesh.faces]
        edge = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean()
        pinned = np.zeros(len(mesh.vertices), bool) if state.pinned is None else state.pinned
        given = {"carried": mesh.vertices_numpy()[:, :0], "fixed": pinned}
        done = remeshed(mesh, 0.7 * edge, passes=3, **given)
        assert not np.array_equal(done.mesh.faces, mesh.faces)
        return Change(mesh=done.mesh, pinned=done.fixed)

    def states(job):
        states = fit(job.image, job.grid, job.mesh, job.optics, settings=job.settings.fit)
        change, opened = None, False
        while True:
            state = states.send(change)
            change = yield state
            if not closed and not opened and change is None:
                opened, change = True, renewed(state)
            elif change is None and state.converged:
                change = Change()

    monkeypatch.setattr(worker, "start", states)
    return closed


@pytest.fixture
def begun(make_widget, with_image, spin, gate):
    """A fit that runs."""
    widget = make_widget()
    mesh = START
    frame = widget.doc.image.frame()
    with_image.add_surface((mesh.vertices_numpy(), mesh.faces), **frame.layer_options())
    with_image.dims.set_point(0, CENTER[0] + 1)
    widget.start()
    spin(lambda: widget.doc.link.mesh is not None and len(widget.doc.run.history.loss) > 2)
    return widget


def remesh(widget, gate, spin):
    before = widget.doc.link.mesh
    gate.clear()
    spin(lambda: not same_triangles(widget.doc.link.mesh, before))
    return before


def pin_right(widget):
    edits, mesh = widget.edits, widget.doc.link.mesh
    edits.pin(mesh.vertices_numpy()[:, 2] > CENTER[2] + 0.5, True, mesh)


def test_pins_shown_are_those_of_the_fit(begun, with_image, gate, spin):
    pin_right(begun)
    spin(lambda: begun.doc.run.state.pinned is not None)
    n = int(begun.doc.run.state.pinned.sum())
    places = begun.doc.run.state.mesh.vertices_numpy()[begun.doc.run.state.pinned]
    remesh(begun, gate, spin)
    pause(begun, spin)
    state, marks = begun.doc.run.state, with_image.layers["cell: pinned"]
    assert state.pinned.sum() >= n
    np.testing.assert_array_equal(begun.edits.pinned, state.pinned)
    np.testing.assert_allclose(marks.data, begun.doc.link.mesh.vertices_numpy()[state.pinned])
    assert {tuple(p) for p in places} <= {tuple(p) for p in marks.data}
    assert begun.running.edit.pins.text().startswith(f"Free {state.pinned.sum()} ")


@pytest.mark.slow
def test_pins_are_those_of_the_newest_state_before_the_window_has_shown_it(begun, gate):
    pin_right(begun)
    run, asked_of = begun.doc.run, begun.doc.present().state.mesh
    until = time.monotonic() + 30
    while run.state.pinned is None and time.monotonic() < until:
        time.sleep(0.01)  # the thread goes on; the window does not
    gate.clear()
    while same_triangles(run.state.mesh, asked_of) and time.monotonic() < until:
        time.sleep(0.01)
    run.paused = True
    state = None
    while state is not run.state:
        state = run.state
        time.sleep(0.2)
    assert not same_triangles(state.mesh, asked_of)
    np.testing.assert_array_equal(begun.edits.pinned, state.pinned)


@pytest.mark.slow
def test_undo_and_redo_of_pins_across_a_remeshing(begun, gate, spin):
    pin_right(begun)
    spin(lambda: begun.doc.run.state.pinned is not None)
    remesh(begun, gate, spin)
    bar = begun.running.history
    bar.undo_button.click()
    spin(lambda: begun.doc.run.state.pinned is None)
    assert not begun.edits.pinned.any()
    bar.redo_button.click()
    spin(lambda: begun.doc.run.state.pinned is not None)
    state = begun.doc.run.state
    assert (state.mesh.vertices_numpy()[state.pinned][:, 2] > CENTER[2] + 0.2).all()


def test_undo_of_a_nudge_brings_the_triangles_and_the_pins_back(begun, gate, spin):
    pin_right(begun)
    spin(lambda: begun.doc.run.state.pinned is not None)
    pause(begun, spin)
    old, pinned = begun.doc.run.state.mesh, begun.doc.run.state.pinned.copy()
    begun.edits.shift(np.full((len(old.vertices), 3), 0.05), "nudge", old)
    begun.footer.pause_button.click()
    spin(lambda: any(m.note == "nudge" for m in begun.doc.timeline.moments))
    remesh(begun, gate, spin)
    pause(begun, spin)
    begun.running.history.undo_button.click()
    spin(lambda: same_triangles(begun.doc.link.mesh, old))
    np.testing.assert_array_equal(begun.doc.run.state.pinned, pinned)


def test_a_stroke_during_which_the_fit_is_remeshed(begun, gate, spin):
    begun.running.edit.use("nudge")
    begun.running.edit.radius.setValue(0.6)
    v = begun.doc.link.mesh.vertices_numpy()
    place = np.array([CENTER[0], CENTER[1], v[:, 2].max()])
    mouse = Mouse(begun.doc.link.viewer, begun.doc.link)
    assert mouse.press(place)
    mouse.move(place + 0.5 * ALONG_X)
    remesh(begun, gate, spin)
    far = begun.doc.link.mesh.vertices_numpy()[:, 2].max()
    mouse.release(place + 0.5 * ALONG_X)
    spin(lambda: any(m.note == "nudge" for m in begun.doc.timeline.moments))
    moment = next(m for m in begun.doc.timeline.moments if m.note == "nudge")
    assert moment.mesh.vertices_numpy()[:, 2].max() > far + 0.2
    assert begun.doc.run.running


@pytest.mark.slow
def test_looking_back_across_a_remeshing_and_going_on_from_there(begun, with_image, gate, spin):
    pin_right(begun)
    spin(lambda: begun.doc.run.state.pinned is not None)
    spin(lambda: len(begun.doc.timeline.moments) > 3)
    before = remesh(begun, gate, spin)
    bar = begun.running.history
    spin(lambda: begun.running.history.slider.maximum() > 1)
    bar.slider.setValue(1)
    assert same_triangles(begun.doc.link.shown, before)
    assert len(with_image.layers["cell: pinned"].data) in (0, begun.doc.run.state.pinned.sum())
    begun.results.choose(1)
    bar.go_on_button.click()
    spin(lambda: any("back to" in m.note for m in begun.doc.timeline.moments))
    assert begun.doc.run.state.pinned is not None
    begun.stop()
    spin(lambda: not begun.doc.run.running)
    begun.running.history.go_on_button.click()  # a new run, with the pins
    spin(went_on(begun))
    assert begun.edits.pinned.any()
    begun.stop()
    spin(lambda: not begun.doc.run.running)
    np.testing.assert_array_equal(begun.edits.pinned, begun.doc.result.state.pinned)


def test_cells_can_be_chosen_while_the_surface_is_hidden(begun, with_image, gate, spin):
    remesh(begun, gate, spin)
    assert not begun.doc.link.surface.visible  # it still has the old triangles
    begun.doc.link.highlight(frozenset({1}))
    with_image.dims.ndisplay = 3
    assert len(begun.doc.link.surface.data[0]) == len(begun.doc.link.surface.data[2])
    begun.doc.link.highlight(frozenset())


@pytest.mark.slow
def test_a_session_keeps_the_pins_of_other_triangles(begun, gate, spin, tmp_path):
    pin_right(begun)
    spin(lambda: begun.doc.run.state.pinned is not None)
    remesh(begun, gate, spin)
    begun.stop()
    spin(lambda: not begun.doc.run.running)
    pinned = begun.doc.result.state.pinned
    begun.sessions.save(str(tmp_path / "kept.deltamic"))
    spin(lambda: not begun.sessions.busy)
    begun.sessions.open(str(tmp_path / "kept.deltamic"))
    spin(lambda: not begun.sessions.busy)
    np.testing.assert_array_equal(begun.doc.result.state.pinned, pinned)
    np.testing.assert_array_equal(begun.edits.pinned, pinned)
    marks = [
        layer for layer in begun.doc.link.viewer.layers if layer.name.startswith("cell: pinned")
    ]
    assert len(marks[-1].data) == pinned.sum()
    damaged = load_session(tmp_path / "kept.deltamic")
    assert {len(m.mesh.faces) for m in damaged.result.moments} >= {
        len(START.faces),
        len(damaged.result.state.mesh.faces),
    }
    save_session(tmp_path / "again.deltamic", damaged)


def test_what_waits_is_carried_to_the_mesh_that_the_fit_has():
    coarse, fine = sphere(CENTER, 1.0, subdivisions=2), sphere(CENTER, 1.0, subdivisions=3)
    up = coarse.vertices_numpy()[:, 0] > CENTER[0]
    waiting = Waiting()
    waiting.add(Change(pinned=up), coarse)
    waiting.shift(up[:, None] * ALONG_X, coarse)
    waiting.shift(np.zeros((len(fine.vertices), 3)), fine)
    change = waiting.take().on(fine)
    moved = (change.mesh.vertices_numpy() - fine.vertices_numpy())[:, 2]
    height = fine.vertices_numpy()[:, 0] - CENTER[0]
    assert (moved[height > 0.2] > 0.99).all()
    assert (moved[height < -0.2] < 0.01).all()
    np.testing.assert_array_equal(change.pinned, moved > 0.5)
    assert carried(up, coarse, coarse.with_vertices(coarse.vertices_numpy() + 1)) is up
