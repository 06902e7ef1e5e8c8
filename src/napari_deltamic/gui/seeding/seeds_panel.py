"""Where the fit starts: layers of points, labels and surfaces, mesh files, found cells."""

from __future__ import annotations

import weakref
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from napari.layers import Points
from qtpy.QtWidgets import QFileDialog, QFormLayout, QGroupBox, QWidget

from ...common.triple import Triple
from ...common.words import counted, sentence
from ...errors import InputError, RepairWarning
from ...geometry.formats import MESH_FILES_LISTED, MESH_FILTER
from ...runs.seed_preview import usable
from ...runs.seeds import POINTS_FILE, PointSeeds
from ..document import Document
from ..viewing.cell_layers import LoadedMesh, load_seeds, surface_layer
from ..viewing.frame import Frame, chosen_of, made_by_fit
from ..viewing.listening import Connections
from ..viewing.own_layers import Points as SeedPoints
from ..viewing.own_layers import cut_by_slices
from ..widgets import Note, button, narrow_box, row, slider
from .corrections import Corrections
from .find_cells_button import FindCells
from .preview import Preview
from .seed_list import LINK, Remarks, SeedList

_FOLLOW, _SPHERES = "the membrane", "a sphere"
_WAIT = 100  # ms; changes that follow each other faster are looked at together


class SeedsPanel(QGroupBox):
    """Lets the user choose the cells that a fit starts from."""

    def __init__(self, doc: Document, parent: QWidget | None = None) -> None:
        super().__init__("2  Cells", parent)
        self._doc, self._viewer, self._image = doc, doc.viewer, doc.image
        self.cells = doc.cells
        doc.at_end(self._close)
        self._of_layers = Connections()
        self._time: tuple[int, ...] = ()
        self._voxels: tuple[Any, ...] = ()  # of which image, and how large
        self._added: tuple[Any, str] | None = None  # points, and what was said of them
        self._used = False  # whether a result that started from them is shown
        self._make_fields()
        self._lay_out()
        self._later = doc.background(doc.warned.emit)
        self._connect()
        self._image_changed()
        self._layers_chosen()

    def use_spheres(self, on: bool) -> None:
        self.shape.setCurrentText(_SPHERES if on else _FOLLOW)

    def place_seeds(self) -> None:
        """Let clicks place points in a Points layer: a ticked one, or a new one."""
        try:
            frame = self._image.frame()
        except InputError as error:
            self.note.say(sentence(str(error)))
            return
        layer = self._points_layer()
        if layer is None:
            layer = self._new_points(frame)
            self._viewer.add_layer(layer)
        self._doc.finish_tools.emit(self)
        self._viewer.dims.ndisplay = 2
        self._viewer.layers.selection = {layer}
        layer.visible = True
        layer.mode = "add"

    def add_points(self, things: Sequence[Sequence[Triple]]) -> None:
        """Add a point in each of some things, at the first of its places where a cell can start.

        Places are um in the image's frame. InputError if there is no image.
        """
        frame, read = self._image.frame(), self._image.reader()
        before, grid = self.cells.points(frame), frame.grid(self._image.shape())
        then = partial(self._add_points, len(things), self._image.key())
        if self.cells.spheres:  # which start anywhere, but not in each other
            reach = float(self.radius.value())
            away = [t[0] for t in things if (np.linalg.norm(before - t[0], axis=1) > reach).all()]
            then(away)
        else:
            self._doc.noted.emit("looking for places where cells can start ...")
            self._placing.ask(lambda: usable(things, before, read(), grid), then)

    def _add_points(self, of: int, image: tuple[Any, ...], places: Sequence[Triple]) -> None:
        """Add points at places in an image, and say so; of : for how many things."""
        if image != self._image.key():
            self._doc.noted.emit("")
            return
        if not places:
            self._note_points(
                "No point was added: no cell can start there, or it has a point already. "
                "Click in the cells yourself ('Click cells')."
            )
            return
        self.place_seeds()
        layer, frame = self._points_layer(), self._image.frame()
        layer.mode = "pan_zoom"  # they are to be looked at
        scale, shift = frame.data_to_um(layer)
        added = (np.asarray(places, float) - shift) / scale
        if layer.ndim > 3:
            steps = np.array(self._viewer.dims.current_step[: layer.ndim - 3], float)
            added = np.hstack([np.tile(steps, (len(added), 1)), added])
        layer.data = np.vstack([np.asarray(layer.data), added])
        n, them = len(places), "it" if len(places) == 1 else "them"
        text = f"{counted(n, 'point')} added to '{layer.name}': look at {them}, then press 'Fit'."
        if n < of:
            text += f" In {of - n} of {of} places no cell can start, or it has a point already."
        self._note_points(text)

    def _note_points(self, text: str) -> None:
        """Show a text that holds as long as the points' layer exists."""
        self._added = self._points_layer(), text
        self._doc.noted.emit(text)

    def _layer_removed(self, event: Any) -> None:
        if self._added is not None and event.value is self._added[0]:
            self._doc.unnoted.emit(self._added[1])
            self._added = None

    def finish_placing(self, keep_preview: bool = False) -> None:
        """Let clicks move the view again; the preview goes, or stays until :meth:`make_room`."""
        self.corrections.bar.use(None)
        for layer in self._viewer.layers:
            if isinstance(layer, Points) and str(layer.mode) == "add":
                layer.mode = "pan_zoom"
        self._later.drop()
        if not keep_preview:
            self.preview.clear()
        self._show()

    def make_room(self) -> None:
        """Hide what would cover the meshes of a fit, until seeds are edited."""
        self._used = True
        self.preview.clear()
        for layer in self.cells.ticked:
            # A point covers something only as a sphere as large as its cell.
            if self.cells.spheres or not isinstance(layer, Points):
                layer.visible = False

    def use_file(self, *paths: str) -> None:
        """Add files of meshes and points as layers, which are seeds like others, once read."""
        self._reading.ask(
            partial(load_seeds, list(paths)),
            lambda found: self._doc.guarded(partial(self._place_found, found)),
        )

    def _close(self) -> None:
        self._added = None
        self._of_layers.undo()
        self.remarks.forget()

    # ------------------------------------------------------------------------------------ fields

    def _make_fields(self) -> None:
        self.chooser = SeedList(self.cells, self)
        self.corrections = Corrections(self._doc, self)
        tip = (
            "Then click inside each cell, on any slice or in 3D (there, points lie at the "
            "depth of the middle of the view)."
        )
        self.place = button("Click cells", tip, self.place_seeds, self)
        tip = (
            f"Adds surfaces from {MESH_FILES_LISTED} files and points from {POINTS_FILE} files "
            "(z,y,x or z,y,x,radius) as layers; positions are in um from the centre of the first "
            "voxel."
        )
        self.open_file = button("From file...", tip, self._ask_file, self)
        self._reading = self._doc.background(self._doc.warned.emit)
        self._placing = self._doc.background(self._doc.refuse)
        self.find_cells = FindCells(self._doc, self)
        tip = (
            "'The membrane' finds the dark region around each click, up to its bright membrane: "
            "needs membranes without gaps, and takes seconds per million voxels when the fit "
            "starts. 'A sphere' starts as large as drawn: immediately, but farther from the "
            "membrane, so the fit takes longer."
        )
        self.shape = narrow_box(self, "start from", tip, (_FOLLOW, _SPHERES), 8)
        tip = "Radius of the spheres, um: of the selected points, or of all; and of the next click."
        self.radius = slider(tip, self)
        self.preview = Preview(self._doc, self)
        self.note = Note(self)
        self.note.linkActivated.connect(self.find_cells.find_with)
        self.remarks = Remarks(self._viewer, self)

    def _lay_out(self) -> None:
        layout = QFormLayout(self)
        layout.addRow(row(self.find_cells, self.place, self.open_file, spacing=4))
        layout.addRow("size", self.find_cells.cell_size)
        layout.addRow(self.chooser)
        layout.addRow(self.corrections.bar)
        layout.addRow("start from", self.shape)
        layout.addRow("radius", self.radius)
        layout.addRow("", self.preview)
        layout.addRow(self.note)
        layout.addRow(self.remarks)
        self._form = layout

    def _connect(self) -> None:
        self.find_cells.told.connect(self._show)
        self.find_cells.told.connect(self._doc.cells_changed.emit)
        self.cells.chosen.connect(self._layers_chosen)
        self.corrections.edited.connect(self.find_cells.edited)
        self.corrections.edited.connect(self._show_soon)
        self.corrections.bar.tool_chosen.connect(lambda tool: self._show())
        self.shape.currentTextChanged.connect(self._shape_chosen)
        self.radius.valueChanged.connect(self._resize)
        self.preview.changed.connect(self._previewed)
        doc = self._doc
        doc.finish_placing.connect(self.finish_placing)
        doc.meshes_came.connect(self.make_room)
        doc.points_wanted.connect(self.add_points)
        doc.listen(self._viewer.layers.events.removed, self._layer_removed)
        self._image.changed.connect(self._image_changed)
        doc.work.remarked.connect(self._remarked)
        doc.listen(self._viewer.dims.events.current_step, self._step_changed)

    def _new_points(self, frame: Frame) -> Points:
        points = SeedPoints(
            np.zeros((0, 3)),
            ndim=3,
            name="seeds",
            size=2 * self._drawn_radius(),
            shading="spherical",
            face_color="#ffb000",
            border_color="white",
            opacity=0.6,
            **cut_by_slices(),
            **frame.layer_options(),
        )
        return points.lie_on(self._image.layer)

    # ------------------------------------------------------------------------------- what changes

    def _image_changed(self) -> None:
        self.corrections.forget()
        frame = self._image.known_frame
        if frame is None:
            self.find_cells.forget()
            self._show_soon()
            return
        shape, size = self._image.shape(), frame.voxel_size
        sides = np.asarray(size) * shape
        radius, voxels = float(self.radius.value()), (weakref.ref(self._image.layer), size)
        same = voxels == self._voxels  # another region only: spheres keep their sizes
        self.radius.setRange(2 * min(size), max(float(sides.max()) / 2, radius * same))
        if not same:
            self.radius.setValue(float(sides.min()) / 6)
        self._voxels = voxels
        self.find_cells.suit(shape, size, same=same)
        self.preview.suit(shape, size)
        self._show_soon()

    def _layers_chosen(self) -> None:
        self._of_layers.undo()
        layers = self.cells.ticked
        for layer in layers:
            for name in ("data", "size", "paint", "scale", "translate"):
                if hasattr(layer.events, name):
                    self._of_layers.connect(getattr(layer.events, name), self._show_soon)
        self._show()
        self._show_soon()

    def _step_changed(self, event: Any = None) -> None:
        time = tuple(self._viewer.dims.current_step[:-3])
        if time != self._time:  # other points, and another image
            self._time = time
            self.cells.be_told()
            if not self._used:
                self._later.soon(self._look, _WAIT)

    def _shape_chosen(self, text: str) -> None:
        self.cells.be_spheres(text == _SPHERES)
        self._resize(everything=True)  # not only the point that was added last
        self._show()
        self._show_soon()

    def _show_soon(self, event: Any = None) -> None:
        self._used = False
        self.cells.be_told()
        self._later.soon(self._look, _WAIT)

    def _remarked(self, warning: Warning) -> None:
        """Keep a remark on what was left out of, or repaired in, the cells until these change."""
        if isinstance(warning, RepairWarning):
            self.cells.be_told(str(warning))
            self._show_remarks()

    def _look(self) -> None:
        """Update whatever depends on the seeds, once they no longer change."""
        self.preview.later()
        self._show()
        self._show_remarks()
        self._doc.cells_changed.emit()

    def _previewed(self) -> None:
        self.cells.take_preview(self.preview.mesh if self.preview.isChecked() else None)
        self._show_remarks()
        self._doc.cells_changed.emit()

    def _resize(self, value: float = 0, *, everything: bool = False) -> None:
        for layer in self.cells.points_layers():
            try:
                um = self._image.frame().data_to_um(layer)[0]
            except InputError:
                continue  # said when the fit starts
            size = 2 * self._drawn_radius() / float(np.mean(np.abs(um)))
            layer.current_size = size
            sizes = np.array(layer.size, float)
            chosen = [] if everything else sorted(layer.selected_data)
            sizes[chosen or slice(None)] = size
            layer.size = sizes
        self._show_soon()  # napari does not tell

    def _ask_file(self) -> None:
        filters = f"{MESH_FILTER};;Points (*{POINTS_FILE})"
        paths, _ = QFileDialog.getOpenFileNames(self, "Cells to start from", "", filters)
        if paths:
            self.use_file(*paths)

    def _place_found(self, found: list[LoadedMesh | PointSeeds]) -> None:
        frame = self._image.frame()
        for loaded in found:
            if isinstance(loaded, PointSeeds):
                self._place_points(loaded, frame)
                continue
            self._viewer.add_layer(surface_layer(loaded, frame).lie_on(self._image.layer))
            for remark in loaded.remarks:
                self._doc.warned.emit(remark)

    def _place_points(self, seeds: PointSeeds, frame: Frame) -> None:
        """Add points of a file as a layer: as spheres if all their radii are known."""
        places, radii = seeds.places(frame.grid(self._image.shape())), seeds.radii
        known = radii is not None and bool((np.nan_to_num(radii) > 0).all())
        if known:
            self.use_spheres(True)  # gives all layers the radius of the slider
        elif radii is not None:
            self._doc.warned.emit(f"{seeds.path}: radii are not used, as some points have none")
        layer = self._new_points(frame)
        layer.name = Path(seeds.path).stem
        scale, shift = frame.data_to_um(layer)
        layer.data = (places - shift) / scale
        if known:
            layer.size = 2 * np.asarray(radii) / float(np.mean(np.abs(scale)))
        self._viewer.add_layer(layer)

    def _drawn_radius(self) -> float:
        """Radius to draw points with, um: that of spheres, or a small one over several slices."""
        return float(self.radius.value()) * (1.0 if self.cells.spheres else 0.25)

    # ------------------------------------------------------------------------ notes and remarks

    def _points_layer(self) -> Any:
        """The Points layer that takes clicks: the selected one, else the highest, if any."""
        points = [layer for layer in self.cells.points_layers() if not made_by_fit(layer)]
        return chosen_of(self._viewer, points)

    def _show(self) -> None:
        layers, points = self.cells.ticked, self.cells.points_layers()
        self.corrections.renew()
        shown = bool(points) or not layers
        frame = self._image.known_frame
        sized = self.find_cells.tried and frame is not None
        self._form.setRowVisible(self.find_cells.cell_size, sized)
        self._form.setRowVisible(self.shape, shown)
        self._form.setRowVisible(self.radius, shown and self.cells.spheres)
        self._form.setRowVisible(self.preview, shown and not self.cells.spheres)
        # While labels are corrected, their number stands below the tools.
        texts = [] if self.corrections.count.text() else [self.find_cells.message]
        length = "µm" if frame is None else frame.length
        for field, what in ((self.find_cells.cell_size, "size"), (self.radius, "radius")):
            title: Any = self._form.labelForField(field)
            title.setText(f"{what}, {length}")
        others = [
            f"<a style='color: {LINK}' href='{size!r}'>"
            f"{counted(n, 'cell') + ' of ' if n else ''}{size:.3g} {length}</a>"
            for size, n in self.find_cells.others
        ]
        if others:
            texts.append(f"Or try: {', '.join(others)}.")
        if points:
            n = sum(len(layer.data) for layer in points)
            texts.append(f"{counted(n, 'point')}." if n else "Click inside each cell.")
        elif not layers and not any(texts):
            texts.append("Press 'Find cells', or 'Click cells' and click inside each.")
        self.note.say(" ".join(filter(None, texts)))

    def _show_remarks(self) -> None:
        remarks = self.cells.remarks(self.preview.problems)
        busy = "Looking for the membranes ..." if self.preview.background.busy else ""
        self.remarks.show_remarks(remarks, busy)
