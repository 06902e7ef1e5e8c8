"""Saving the widget as a session, and restoring a session in the widget."""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from ...errors import InputError
from ...fitting.history import History
from ...fitting.job import FitInput, optics_of
from ...fitting.model.default_accuracy import usable_choice
from ...results.session_parts import SavedImage, SavedResult, Session
from ..document import VIEWS, Document
from ..record import Record
from ..seeding.find_cells_button import be_found_in
from ..tracking.panel import TrackPanel
from ..viewing.frame import Frame, go_to
from ..viewing.own_layers import lie_on
from .session_layers import image_layer, save_image, save_layer, seed_layer


@dataclass(frozen=True)
class Parts:
    """The parts of a widget that go into a session."""

    doc: Document
    seeds: Any  # the panel of the cells
    tracking: TrackPanel


def capture(parts: Parts) -> tuple[Session, str]:
    """The present state as a session, and what of it is left out, in words ('' for nothing).

    It shares the arrays of the layers, so that a large image is not copied. InputError if there is
    no image, or a setting that is not valid.
    """
    doc = parts.doc
    dims, frame = doc.viewer.dims, doc.image.frame()
    result, left_out = _result(doc, frame)
    pixels = result[1].as_read if result else doc.image.stack()
    shown = {"scene": doc.settings.scene_settings()}  # with the widths of a PSF that is open
    step, point = tuple(dims.current_step), tuple(float(p) for p in dims.point)
    tracks = parts.tracking.saved()
    if tracks is None and parts.tracking.results:
        others = "the tracks are of another image or region and were not saved in this session"
        left_out = "; ".join(filter(None, (left_out, others)))
    session = Session(
        settings=doc.run_settings().model_copy(update=shown),
        image=save_image(doc.image.layer, pixels, frame),
        seeds=tuple(save_layer(seed, step, point, frame) for seed in doc.cells.ticked),
        result=result[0] if result else None,
        panels={
            "seeds": {name: get() for name, (get, _) in _fields(parts.seeds).items()},
            "shown": {"view": doc.view},
            "view": {"ndisplay": dims.ndisplay, "point": point[-3:], "time": point[:-3]},
            "accuracy": doc.settings.accuracy,
            "psf_is_open": doc.settings.psf_is_open,
            "result_time": doc.records[doc.image.layer].link.time if result else [],
        },
        second=_second(doc, frame, result[1] if result else None),
        tracks=tracks,
    )
    return session, left_out


def restore(parts: Parts, session: Session) -> Generator[None]:
    """Show a session: its layers are added, the panels show what they did.

    Where it yields, the window may do what waits: cells come after the image, then the result.
    InputError if something runs.
    """
    doc, viewer = parts.doc, parts.doc.viewer
    if doc.work.occupied:
        raise InputError(doc.work.occupied)
    empty = not viewer.layers
    image, seeds, second = _layers(session)  # before anything is changed
    view = session.panels.get("view", {})
    if empty and "ndisplay" in view:  # now it is only a number: later all is drawn anew
        viewer.dims.ndisplay = int(view["ndisplay"])
    viewer.add_layer(image)
    doc.image.choose(image)  # first: which cells were ticked for the image before is noted
    for seed in doc.cells.ticked:
        doc.cells.choose(seed, False)
    for _ in _shown_with(parts, session, image, seeds, second):
        yield
        if _left(doc, image):
            return
    if empty:
        viewer.reset_view()


def _shown_with(
    parts: Parts, session: Session, image: Any, seeds: list[Any], second: Any
) -> Generator[None]:
    """Show the rest of a session, whose image is there already, in steps."""
    doc, viewer, panels = parts.doc, parts.doc.viewer, session.panels
    yield
    doc.settings.show_fit(session.settings.fit)
    is_open = bool(panels.get("psf_is_open", False))
    doc.settings.show_scene(session.settings.scene, psf_is_open=is_open)
    _show_second(doc, session, second)
    with suppress(ValueError):  # without a name of it the number is shown
        doc.settings.show_accuracy(usable_choice(panels.get("accuracy")))
    # Before the layers: sizes of points follow these fields.
    for name, (_, put) in _fields(parts.seeds).items():
        if name in panels.get("seeds", {}):
            put(panels["seeds"][name])
    for seed in seeds:
        lie_on(seed, image)
        be_found_in(seed, image)
        viewer.add_layer(seed)
        doc.cells.choose(seed)
    if session.result is not None or session.tracks is not None:
        doc.finish_placing.emit(False)  # no preview of the start over its result
    yield
    if session.tracks is not None:
        parts.tracking.reopen(session.tracks)
        yield
        # The surface of a fit belongs to the time that is shown when it comes.
        for axis, step in enumerate(panels.get("result_time", ())):
            viewer.dims.set_current_step(axis, int(step))
    if session.result is not None:
        yield from _show_result(doc, session.result, session)
    looked = panels.get("shown", {}).get("view")
    doc.look(looked if looked in VIEWS else "image")
    viewer.layers.selection = {image}
    yield from _show_view(viewer, panels.get("view", {}))


def _left(doc: Document, image: Any) -> bool:
    """Whether the user has started something else meanwhile."""
    return bool(doc.work.occupied) or doc.image.layer is not image


def _layers(session: Session) -> tuple[Any, list[Any], Any]:
    """Layers of image, seeds and second view of a session. InputError if they cannot be made."""
    try:
        image = image_layer(session.image, session.tracks)
        seeds = [seed_layer(seed) for seed in session.seeds]
        second = image_layer(session.second) if session.second is not None else None
    except InputError:
        raise
    except Exception as error:  # napari's, of options that it does not know
        reason = " ".join(str(error).split())[:200]
        raise InputError(f"the session is damaged, nothing was opened: {reason}") from error
    return image, seeds, second


# ---- results -------------------------------------------------------------------------------------


def _result(doc: Document, frame: Frame) -> tuple[tuple[SavedResult, FitInput] | None, str]:
    """The newest state of the chosen image's fit, with its job; or None, and what is left out."""
    run, found = doc.run, doc.result_of_image()
    if found is None:
        others = [other for other in doc.records.values() if other.state is not None]
        if doc.running and doc.present() is not None and doc.record is not None:
            others.append(doc.record)
        return None, _of_another(others[-1]) if others else ""
    record, present = found
    if record.link.frame != frame:
        return None, _of_another(record)
    verdict, message = record.words
    course: Any = run if present.running else record.reached
    if present.running:
        verdict, message = "stopped", "saved while the fit was running"
    history = course.history
    job, known = present.job, min(len(history.loss), len(history.level), len(history.blur))
    saved = SavedResult(
        settings=job.settings,
        state=present.state,
        # A copy: a fit that runs goes on adding to it.
        history=History(
            history.loss[:known], history.level[:known], history.blur[:known], history.first
        ),
        seconds=course.seconds,
        verdict=verdict,
        message=message,
        start=job.mesh,
        moments=record.timeline.moments,
        counted=job.counted,
    )
    return (saved, job), ""


def _of_another(record: Record) -> str:
    return (
        f"the result is of another image ('{record.link.image_layer.name}'), or its voxel size was "
        "changed: it is not in this session"
    )


def _second(doc: Document, frame: Frame, job: FitInput | None) -> SavedImage | None:
    """The layer of the second view, with the pixels that the result was fitted to."""
    layer, pixels = doc.second.layer, doc.second.pixels()
    if layer is None or pixels is None:
        return None
    if job is not None and job.second is not None:
        pixels = job.second
    return save_image(layer, pixels, frame)


def _show_second(doc: Document, session: Session, layer: Any) -> None:
    view = session.settings.scene.effects.view
    if layer is not None and view is not None:
        doc.viewer.add_layer(layer)
        doc.second.show(layer, view.sigma)
    else:  # not that of the image before
        doc.second.show(None)


def _show_result(doc: Document, result: SavedResult, session: Session) -> Generator[None]:
    image, second = session.image, session.second
    has_second = result.settings.scene.effects.view is not None
    job = FitInput(
        settings=result.settings,
        image=image.pixels,
        grid=image.grid,
        mesh=result.start or result.state.mesh,
        optics=optics_of(result.settings.scene),
        counted=result.counted,
        second=second.pixels if second is not None and has_second else None,
    )
    doc.select(())
    yield from doc.reopen(result, job.without_hot())


# ---- panels --------------------------------------------------------------------------------------


def _fields(seeds: Any) -> dict[str, tuple[Callable[[], Any], Callable[[Any], None]]]:
    """For each field of the cells' panel, how to read it, and how to show a value."""
    size = seeds.find_cells.cell_size
    return {
        "start_as": (seeds.shape.currentText, lambda text: seeds.use_spheres("sphere" in text)),
        "radius": (seeds.radius.value, seeds.radius.setValue),
        "cell_size": (size.value, size.setValue),
        "preview": (seeds.preview.isChecked, seeds.preview.prefer),
    }


def _show_view(viewer: Any, shown: dict[str, Any]) -> Generator[None]:
    """Restore the view in steps; napari may draw wherever this yields."""
    yield
    if "ndisplay" in shown:
        viewer.dims.ndisplay = int(shown["ndisplay"])
        yield
    if "point" in shown:
        go_to(viewer, shown["point"])
        yield
    if len(shown.get("time", ())) == viewer.dims.ndim - 3 > 0:
        viewer.dims.set_point(range(viewer.dims.ndim - 3), [float(p) for p in shown["time"]])
        yield
