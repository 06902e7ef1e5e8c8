"""What a fit would be of, as the panels show it: for its forecast and for measurements."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from napari.layers import Labels, Points, Surface
from numpy.typing import NDArray

from ...accuracy.forecast import Forecast, forecast
from ...accuracy.machine_costs import costs
from ...fitting.default_accuracy import image_noise
from ...fitting.job import SeedKind, optics_of
from ...geometry import Mesh, sphere
from ...geometry.labels.meshes import EDGE_IN_VOXELS
from ...optics import Optics
from ...runs.settings import NEAR_LEVELS, FitSettings, SceneSettings
from ...scene import Grid
from ..document import Document, missing_cells
from ..seeding.seed_kinds import at_time, seeds_from_layer
from ..viewing.frame import FloatArray, Frame, unread_stack_of
from .accuracy_dial import accuracy_of

Surfaces = Callable[[Grid], Mesh | None]


@dataclass(frozen=True, eq=False)
class SceneNow:
    """A fit that could be started; nothing in it knows of a widget or a layer.

    choice : of the accuracy dial.
    image : (Z, Y, X), or what becomes such an array.
    scene : PSF and effects.
    settings : of the fit; the accuracy is that of the choice.
    kind : of the seeds, which decides the levels.
    surfaces : make the starting surfaces, or cheap ones about as large; may take a while.
    guessed : whether their size is a guess.
    """

    choice: str
    image: Any
    grid: Grid
    scene: SceneSettings
    settings: FitSettings
    kind: SeedKind
    surfaces: tuple[Surfaces, ...]
    guessed: bool

    @property
    def optics(self) -> Optics:
        """The PSF, computed when asked. InputError where it cannot be."""
        return optics_of(self.scene)

    def pixels(self) -> NDArray[Any]:
        """(Z, Y, X)."""
        return np.asarray(self.image)

    def touching(self) -> bool | None:
        """Whether cells touch, where only labels tell; None where the surfaces do."""
        parts: list[Any] = [
            p for p in self.surfaces if getattr(p, "func", None) is _balls_of_labels
        ]
        return any(_touch(np.asarray(part.args[0])) for part in parts) if parts else None

    def mesh(self) -> Mesh:
        """The surfaces. InputError where there are none."""
        found = [make(self.grid) for make in self.surfaces]
        return Mesh.merge([mesh for mesh in found if mesh is not None])


@dataclass(frozen=True)
class Outlook:
    """What a scene costs: noise of its image, accuracy that the choice stands for, forecast."""

    noise: float
    accuracy: float
    forecast: Forecast
    guessed: bool


def outlook(scene: SceneNow) -> Outlook:
    """The forecast of a scene; measures this machine where that was never done (a second)."""
    known = costs(measure=True)
    pixels = scene.pixels()
    noise = image_noise(pixels)
    accuracy = accuracy_of(scene.choice, noise)
    found: dict[str, Any] = {"accuracy": accuracy}
    if scene.kind != "rough" and scene.settings.levels is None:
        found["levels"] = NEAR_LEVELS
    settings = scene.settings.model_copy(update=found)
    effects = scene.scene.effects
    given = scene.grid, scene.mesh(), scene.optics, settings
    expected = forecast(pixels, *given, None, effects, known, scene.touching())
    return Outlook(noise, accuracy, expected, scene.guessed)


class NoiseOf:
    """The noise of the image chosen, measured once for each image and time."""

    def __init__(self, doc: Document) -> None:
        self._doc = doc
        self._of: tuple[Any, ...] = ()
        self._noise: float | None = None
        self.held = False  # while a fit runs, that of its image counts

    def __call__(self) -> float:
        """The noise. InputError if there is no image."""
        known = self.known
        if known is None:
            known = image_noise(self._doc.image.stack())
            self.learn(self.key(), known)
        return known

    @property
    def known(self) -> float | None:
        """The noise where it was measured, else None."""
        return self._noise if self.held or self._of == self.key() else None

    def key(self) -> tuple[Any, ...]:
        """What it is the noise of."""
        image = self._doc.image
        if image.layer is None:
            return ()
        return weakref.ref(image.layer), id(image.layer.data), image.time, image.box

    def learn(self, key: tuple[Any, ...], noise: float) -> None:
        """Take over what was measured elsewhere."""
        if key and not self.held:
            self._of, self._noise = key, noise


def scene_key(doc: Document) -> tuple[Any, ...]:
    """The same as long as image, voxel size and PSF are."""
    image = doc.image
    size = None if image.layer is None else tuple(image.layer.scale)
    return id(image.layer), image.time, image.box, size, doc.settings.optics.key()


def scene_now(doc: Document) -> SceneNow:
    """The scene as it is chosen; touches no voxel. InputError if something is missing."""
    image, frame = doc.image, doc.image.frame()
    grid = frame.grid(image.shape())
    scene = doc.settings.scene_settings()
    kind, surfaces, guessed = _surfaces(doc, frame, grid)
    return SceneNow(
        choice=doc.settings.accuracy.choice,
        image=image.unread(image.layer),
        grid=grid,
        scene=scene,
        settings=doc.settings.other_settings(),
        kind=kind,
        surfaces=surfaces,
        guessed=guessed,
    )


def _surfaces(
    doc: Document, frame: Frame, grid: Grid
) -> tuple[SeedKind, tuple[Surfaces, ...], bool]:
    """How near the seeds are to the membranes, what makes surfaces of them, and if it guesses."""
    point = tuple(float(p) for p in doc.viewer.dims.point)
    step = tuple(doc.viewer.dims.current_step)
    points, radii = [], []
    made: list[Any] = []  # Surfaces
    rough, guessed = False, False
    spheres = doc.cells.spheres
    for layer in doc.cells.ticked():
        if isinstance(layer, Points):
            if at_time(layer, layer.data, point).any():
                own: Any = seeds_from_layer(layer, frame, step, spheres=spheres, point=point)
                points.append(own.points)
                radii.append(own.radii)
        elif isinstance(layer, Labels):
            made.append(partial(_balls_of_labels, unread_stack_of(layer, step)))
            guessed = True
        elif isinstance(layer, Surface):
            scale, shift = frame.data_to_um(layer)
            made.append(partial(_as_it_is, layer.data[0], layer.data[1], scale, shift))
            rough = True
    if points:
        centres = np.concatenate(points)
        whole = None if spheres else _known_surfaces(doc, len(centres))
        if spheres:
            rough = True
            made.append(partial(_balls, centres, np.concatenate(radii)))
        elif whole is not None:
            made.append(partial(_given, whole))
        else:
            guessed = True
            made.append(partial(_balls, centres, None))
    if not made:
        raise missing_cells()
    labelled = any(part.func is _balls_of_labels for part in made)
    near: SeedKind = "rough" if rough else "labels" if labelled else "image"
    return near, tuple(made), guessed


def _known_surfaces(doc: Document, points: int) -> Mesh | None:
    """What the preview shows, else what the fit of this image has or found."""
    preview = doc.cells.preview_mesh()
    if isinstance(preview, Mesh):
        return preview
    record = doc.record
    if record is None or record.link.image_layer is not doc.image.layer:
        return None
    state = doc.run.state if doc.running else record.state
    if state is None:
        return None
    mesh: Mesh = state.mesh
    return mesh if len(np.unique(mesh.regions[mesh.regions > 0])) == points else None


def _given(mesh: Mesh, grid: Grid) -> Mesh:
    return mesh


def _as_it_is(vertices: Any, faces: Any, scale: FloatArray, shift: FloatArray, grid: Grid) -> Mesh:
    """Of a Surface layer; of a series, those of its first time, as others are much alike."""
    vertices, faces = np.asarray(vertices, float), np.asarray(faces)
    if vertices.shape[1] > 3:
        first = vertices[faces[:, 0], :-3]
        faces = faces[(first == first[0]).all(axis=1)]
    return Mesh(vertices[:, -3:] * scale + shift, faces)


def _balls(centres: FloatArray, radii: FloatArray | None, grid: Grid) -> Mesh:
    """Spheres around points, as large as their distances and the image let them be."""
    edge = EDGE_IN_VOXELS * min(grid.voxel_size)
    if radii is None or not np.all(np.nan_to_num(radii) > 0):
        apart = np.linalg.norm(centres[:, None] - centres[None], axis=-1)
        np.fill_diagonal(apart, np.inf)
        side = float(np.multiply(grid.shape, grid.voxel_size).min())
        guess = np.clip(0.45 * apart.min(axis=1), 2 * edge, max(side / 3, 2 * edge))
        radii = guess if radii is None else np.where(np.nan_to_num(radii) > 0, radii, guess)
    return Mesh.merge(
        [sphere(c, float(r), edge_length=edge) for c, r in zip(centres, radii, strict=True)]
    )


def _touch(labels: NDArray[Any]) -> bool:
    """Whether voxels of two labels lie side by side."""
    for axis in range(labels.ndim):
        a, b = (np.moveaxis(labels, axis, 0)[k] for k in (slice(1, None), slice(None, -1)))
        if ((a != b) & (a > 0) & (b > 0)).any():
            return True
    return False


def _balls_of_labels(labels: Any, grid: Grid) -> Mesh | None:
    """A sphere as large as each label."""
    labels = np.asarray(labels)
    if labels.ndim != 3 or labels.min(initial=0) < 0:
        return None
    numbers, volumes = np.unique(labels[labels > 0], return_counts=True)
    if not len(numbers):
        return None
    radii = np.cbrt(3 / (4 * np.pi) * volumes * float(np.prod(grid.voxel_size)))
    middle = (np.asarray(grid.shape) - 1) / 2 * grid.voxel_size
    # Where they lie makes no difference to what they cost, as long as it is in the image.
    return _balls(np.tile(middle, (len(numbers), 1)), radii, grid)
