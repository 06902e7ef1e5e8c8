"""What a user may do in the window, sensible or not; see ``window``."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .window_anything import any_item, anything
from .window_session import CENTER, SHAPE, SIZE, Action, Session


def actions(session: Session) -> list[Action]:
    """All of them; those of a fit more often."""
    named = _fitting(session) * 2 + _settings(session) + _seeds(session) + _viewer(session)
    named += _images(session) + _others(session)
    return named + [("anything", lambda: anything(session))] * (len(named) // 2)


def _fitting(s: Session) -> list[Action]:
    rng = s.rng

    def begin() -> None:
        """A fit that has all it needs."""
        w = s.widget
        if s.running:
            return
        w.doc.image.choose(s.viewer.layers["cell"])
        w.settings.accuracy.setCurrentText("1e-2")
        w.settings.max_iterations.setValue(rng.choice([5, 40, 2000]))
        w.seeds.place.click()
        for layer in list(s.viewer.layers):
            w.seeds.cells.choose(layer, layer.name == "seeds")
            if layer.name == "seeds":
                layer.selected_data = set()
                layer.data = [CENTER]
        w.start()
        run = w.doc.run
        s.spin(2, lambda: run is None or bool(run.state) or not run.running)
        s.did["fits"] += run is not None and run.state is not None

    def stroke() -> None:
        """With whatever tool is in use, wherever there is or was a surface."""
        link = s.widget.doc.link
        if link is None:
            return
        if rng.random() < 0.5:
            s.widget.running.history.to_live()
            s.viewer.dims.set_point(s.viewer.dims.ndim - 3, CENTER[0])
            edit_bar().use(rng.choice(["nudge", "push", "pin"]))
        places = [np.array(CENTER) + rng.choice([0, 0.9, 1.3]) * _unit(s) for _ in range(3)]
        s.did["strokes"] += drag(s, link.frame, places, shift=rng.random() < 0.3)

    def edit_bar() -> Any:
        return s.widget.running.edit

    def history() -> Any:
        return s.widget.running.history

    return [
        ("begin", begin),
        ("stroke", stroke),
        ("stroke", stroke),
        ("tool", lambda: edit_bar().use(rng.choice(["nudge", "push", "pin", None]))),
        ("radius", lambda: edit_bar().radius.setValue(rng.uniform(0.05, 3))),
        ("pins", lambda: edit_bar().pins.click()),
        (
            "look back",
            lambda: history().slider.setValue(rng.randrange(history().slider.maximum() + 1)),
        ),
        ("newest", lambda: history().live_button.click()),
        ("go on from here", lambda: history().go_on_button.click()),
        ("undo", lambda: history().undo_button.click()),
        ("redo", lambda: history().redo_button.click()),
        ("pause", lambda: s.widget.footer.pause_button.click()),
        ("run", lambda: s.widget.start()),
        ("stop", lambda: s.widget.stop()),
        ("view", lambda: s.widget.running.view.setCurrentIndex(rng.randrange(4))),
        ("slices", lambda: s.widget.running.slice.activated.emit(rng.randrange(3))),
        ("row", lambda: s.widget.results.table.selectRow(0)),
        ("wait", lambda: s.spin(0.15)),
    ]


def _settings(s: Session) -> list[Action]:
    rng = s.rng

    def of() -> Any:
        return s.widget.settings

    def effect() -> None:
        table = of().effects.table
        table.tick(rng.choice(["halo", "attenuation", "pixel_integration"]))

    def check() -> None:
        s.widget.settings.effects.button.start()
        s.did["checks"] += s.widget.settings.effects.button.busy

    return [
        ("fit psf", lambda: of().fit_psf.setChecked(rng.random() < 0.5)),
        ("density", lambda: of().density.setCurrentIndex(rng.randrange(3))),
        ("likelihood", lambda: of().fields["likelihood"].setCurrentIndex(rng.randrange(3))),
        (
            "accuracy",
            lambda: of().accuracy.setCurrentText(rng.choice(["1e-2", "3e-3", "x", "", "0"])),
        ),
        ("sigma", lambda: of().sigma._boxes[rng.randrange(3)].setValue(rng.uniform(0.2, 0.4))),
        ("kind of psf", lambda: of().optics.kind.setCurrentIndex(rng.randrange(3))),
        ("effect", effect),
        ("check effects", check),
        ("stop the check", lambda: s.widget.doc.work.stop()),
        ("use recommended", lambda: of().effects.take_button.click()),
        ("measure", lambda: of().tradeoff.findChildren(_button())[0].click()),
        ("second view", lambda: any_item(s, of().effects.second.chooser)),
    ]


def _seeds(s: Session) -> list[Action]:
    rng = s.rng

    def of() -> Any:
        return s.widget.seeds

    def points() -> list[Any]:
        return [layer for layer in s.viewer.layers if layer.name.startswith("seeds")]

    def add(place: Any) -> None:
        for layer in points():
            layer.add(place if layer.ndim == 3 else (0, *place))

    def find() -> None:
        of().find_cells.start()
        s.spin(3, lambda: not of().find_cells.background.busy)
        s.did["cells looked for"] += 1

    def correct() -> None:
        tool = rng.choice(["split", "merge", "remove", None])
        of().corrections.bar.use(tool)
        frame = _frame(s)
        if tool is not None and frame is not None:
            s.viewer.dims.set_point(s.viewer.dims.ndim - 3, CENTER[0])
            for _ in range(2):
                place = np.array(CENTER) + rng.choice([0, 0.5, 1.6]) * _unit(s)
                drag(s, frame, [place])
            s.did["corrections"] += 1

    def paint() -> None:
        for layer in s.viewer.layers:
            if layer.name == "found cells":
                layer.data_setitem(
                    tuple(np.full(1, rng.randrange(n)) for n in layer.data.shape), rng.randrange(40)
                )

    return [
        ("place", lambda: of().place.click()),
        ("add a point", lambda: add(CENTER)),
        ("add a point anywhere", lambda: add([rng.uniform(-1, 6) for _ in range(3)])),
        ("add a point nowhere", lambda: add((np.nan, 1.0, 1.0))),
        ("shape", lambda: of().shape.setCurrentIndex(rng.randrange(2))),
        ("radius of seeds", lambda: of().radius.setValue(rng.uniform(0.5, 2))),
        ("preview", lambda: of().preview.click()),
        ("tick", lambda: [of().cells.choose(x, rng.random() < 0.5) for x in s.viewer.layers]),
        ("find cells", find),
        ("correct", correct),
        ("correct", correct),
        ("undo a correction", lambda: of().corrections.undo()),
        ("paint", paint),
    ]


def _viewer(s: Session) -> list[Action]:
    rng = s.rng

    def dims() -> Any:
        return s.viewer.dims

    def zoom() -> None:
        camera = getattr(s.viewer, "scene", s.viewer).camera
        camera.zoom = 10 ** rng.uniform(-1, 3)

    return [
        ("slice", lambda: dims().set_point(dims().ndim - 3, rng.uniform(-1, 7))),
        ("2D or 3D", lambda: setattr(dims(), "ndisplay", rng.choice([2, 3]))),
        (
            "axes",
            lambda: setattr(dims(), "order", tuple(rng.sample(range(dims().ndim), dims().ndim))),
        ),
        ("zoom", zoom),
        ("reset", lambda: s.viewer.reset_view()),
        ("theme", lambda: setattr(s.viewer, "theme", rng.choice(["dark", "light"]))),
        (
            "select",
            lambda: s.viewer.layers.selection.select_only(rng.choice(list(s.viewer.layers))),
        ),
        ("hide", lambda: setattr(rng.choice(list(s.viewer.layers)), "visible", rng.random() < 0.6)),
    ]


def _images(s: Session) -> list[Action]:
    rng = s.rng
    zeros = {
        "plane": ((20, 24), {}),
        "colour": ((20, 24, 24, 3), {"rgb": True}),
        "five axes": ((2, 2, *SHAPE), {}),
        "channels": ((20, 2, 24, 24), {}),
        "series": ((3, *SHAPE), {"scale": (1, *SIZE)}),
    }

    def add() -> None:
        if len(s.viewer.layers) > 12:
            return drop()
        kind = rng.choice([*zeros, "other", "other"])
        if kind == "other":
            s.viewer.add_image(s.pixels[::-1].copy(), name="other", scale=np.multiply(SIZE, 2))
        else:
            shape, options = zeros[kind]
            s.viewer.add_image(np.zeros(shape, np.uint8), name=kind, **options)

    def drop() -> None:
        """What is removed is any layer but the image and those of a fit that runs."""
        names = [x.name for x in s.viewer.layers if x.name != "cell"]
        if names and s.offscreen:
            del s.viewer.layers[rng.choice(names)]

    def mirror() -> None:
        layer = s.viewer.layers["cell"]
        layer.scale = np.multiply(SIZE, rng.choice([(1, 1, 1), (1, -1, 1)]))

    return [
        ("add an image", add),
        ("remove a layer", drop),
        ("remove a layer", drop),
        ("choose an image", lambda: any_item(s, s.widget.image.chooser)),
        ("choose a channel", lambda: any_item(s, s.widget.image.channels)),
        ("choose the cell", lambda: s.widget.doc.image.choose(s.viewer.layers["cell"])),
        (
            "voxel size",
            lambda: s.widget.image.voxel_size._boxes[0].setValue(rng.uniform(0.2, 0.4)),
        ),
        ("mirror", mirror),
    ]


def _others(s: Session) -> list[Action]:
    rng = s.rng

    def save() -> bool:
        """Whether there was something to save."""
        from napari_deltamic.errors import InputError

        try:
            s.widget.sessions.save(str(s.folder / "a.deltamic"))
        except InputError:
            return False
        s.spin(20, lambda: not s.widget.sessions.busy)
        return True

    def reopen() -> None:
        """What was saved, looked at and opened again."""
        from napari_deltamic.results.session_file import load_session

        path = s.folder / "a.deltamic"
        if s.running or len(s.viewer.layers) > 12 or not s.offscreen or not save():
            return
        saved, last = load_session(path).result, s.widget.doc.result
        if saved is not None and last is not None:
            mesh = saved.state.mesh.vertices_numpy()
            if not np.array_equal(mesh, last.state.mesh.vertices_numpy()):
                s.wrong("the session has not the result that is shown")
        s.did["sessions"] += saved is not None
        s.widget.sessions.open(str(path))
        s.spin(20, lambda: not s.widget.sessions.busy)

    def close() -> None:
        """The dock, and open it again."""
        if rng.random() < 0.3:
            s.viewer.window.remove_dock_widget(s.widget)
            s.dock()
            s.did["docks"] += 1

    def save_meshes() -> None:
        if s.widget.doc.result is not None:
            s.widget.results.save_meshes(str(s.folder / "a.ply"))

    def track() -> None:
        s.widget.tracking.start()

    def stop_tracking() -> None:
        work = s.widget.tracking.work
        if work is not None and work.running:
            s.widget.stop()

    return [
        ("save a session", save),
        *[("reopen a session", reopen)] * 4,
        ("close the dock", close),
        ("save meshes", save_meshes),
        ("copy command", lambda: s.widget.commands.copy_action.trigger()),
        ("track", track),
        ("stop tracking", stop_tracking),
    ]


# ---------------------------------------------------------------------------------------- parts


def drag(s: Session, frame: Any, places: list[Any], *, shift: bool = False) -> bool:
    """Press at the first place (um), go through the others, release; whether it was used."""
    from napari.utils import interactions
    from napari.utils._proxies import ReadOnlyWrapper

    in_3d, direction = s.viewer.dims.ndisplay == 3, _unit(s)
    if in_3d:
        places = [places[0] - 4 * direction, *places[1:]]
    handled = False
    steps = [("mouse_press", places[0]), *(("mouse_move", p) for p in places[1:])]
    for kind, place in [*steps, ("mouse_release", places[-1])]:
        ahead = (0.0,) * (s.viewer.dims.ndim - 3)
        event = ReadOnlyWrapper(
            SimpleNamespace(
                type=kind,
                button=1,
                pos=np.asarray(place)[:2] * 100,
                position=(*ahead, *frame.to_world(place)),
                dims_displayed=list(s.viewer.dims.displayed),
                is_dragging=kind != "mouse_press",
                handled=False,
                modifiers=("Shift",) if shift else (),
                view_direction=direction if in_3d else None,
            ),
            exceptions=("handled",),
        )
        getattr(interactions, f"{kind}_callbacks")(s.viewer, event)
        handled = handled or bool(event.handled)
        if s.rng.random() < 0.3:
            s.spin(0.02)
    return handled


def _unit(s: Session) -> NDArray[np.float64]:
    """(3,) in a random direction."""
    direction = np.array([s.rng.gauss(0, 1) for _ in range(3)])
    return np.asarray(direction / np.linalg.norm(direction), float)


def _frame(s: Session) -> Any:
    from napari_deltamic.errors import InputError

    try:
        return s.widget.doc.image.frame()
    except InputError:
        return None


def _button() -> Any:
    from qtpy.QtWidgets import QPushButton

    return QPushButton
