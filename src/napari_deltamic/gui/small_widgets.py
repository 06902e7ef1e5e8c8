"""The small widgets in napari's menus, which simulate cells and measure surfaces."""

# No annotations as strings here: magicgui makes the fields of them.

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal, Optional

from magicgui import magic_factory
from napari.layers import Image, Surface
from napari.qt.threading import FunctionWorker, create_worker
from napari.types import LayerDataTuple
from napari.utils.notifications import show_warning

from ..common.choices import IMMERSIONS, CellKind
from ..common.description import described
from ..common.words import sentence
from ..common.writing import own_folder
from ..errors import InputError
from ..measure import Known, measure
from ..optics import GaussianPSF, Optics, microscope
from ..results.measured_files import write_measurements
from ..results.mesh_exchange import labels_of
from ..runs.optics_settings import MicroscopeOptics
from ..scene import Grid, Scene, Simulation, random_cells, simulate
from ..scene.effects import Effects
from ..scene.structures import membranes_and_insides
from .cell_source import mesh_of_surface
from .viewing.cell_layers import labels_options
from .viewing.colours import surface_look, vertex_values
from .viewing.frame import OWN, TRUTH, WORLD, Frame, shape_of
from .widgets import Note
from .window_words import attempt, for_window, words_of


def measure_surface(
    surface: Surface,
    image: Optional[Image] = None,  # noqa: UP045  (magicgui reads it)
    folder: Annotated[Optional[Path], {"mode": "d"}] = None,  # noqa: UP045
) -> FunctionWorker[list[LayerDataTuple]]:
    """Measure the cells, walls and junctions of a Surface layer.

    Parameters
    ----------
    surface
        Meshes of a fit, or of a mesh file.
    image
        Image that they were fitted to: tells which cells its border cuts; cells then become a
        Labels layer on its voxels, with the measurements as features.
    folder
        Folder for tables, meshes and labels; a new one, or one without measurements.
    """
    if surface is None:
        raise InputError("there is no Surface layer to measure")
    if image is None and folder is None:
        raise InputError("choose a folder for the tables, or an image for a layer with them")
    frame = WORLD if image is None else Frame.of(image)
    grid = None if image is None else frame.grid(shape_of(image))
    mesh, name = mesh_of_surface(surface, frame), surface.name
    if folder is not None and (folder / "cells.csv").exists():
        raise InputError(f"{folder} holds measurements already: choose another folder")

    def work() -> list[Any]:
        measured = measure(mesh, Known(grid=grid))
        if folder is not None:
            with own_folder(folder):
                write_measurements(folder, mesh, measured, grid=grid)
        if grid is None:
            return []
        options = labels_options(measured.cells.rows, frame, f"{name}: cells")
        return [(labels_of(mesh, grid), options, "labels")]

    return _in_thread(work)


def _in_thread(work: Callable[[], list[Any]]) -> Any:
    """Run a function in a thread; if it fails, the user reads why."""
    return create_worker(work, _start_thread=True, _connect={"errored": _tell})


def _tell(error: Exception) -> None:
    show_warning(for_window(words_of(error)))


def _press_in_words(widget: Any) -> None:
    """Show errors as a sentence; magicgui's button would show a traceback.

    It stands below the button until something is changed: napari's own message soon goes.
    """
    said = Note(widget.native, "fair")
    widget.native.layout().addWidget(said)

    def tell(reason: str) -> None:
        said.say(sentence(reason))
        show_warning(for_window(reason))

    def press() -> None:
        pressed.enabled = False  # as magicgui does
        said.say("")
        attempt(widget, tell)
        pressed.enabled = True

    pressed = widget.call_button
    widget.changed.connect(lambda: said.say(""))
    pressed.changed.disconnect()
    pressed.changed.connect(press)


measure_widget = magic_factory(measure_surface, widget_init=_press_in_words, call_button="Measure")


Lengths = tuple[float, float, float]


def _said(name: str, **more: Any) -> dict[str, Any]:
    """Options to show a number of an objective, from the description of its setting."""
    found = described(MicroscopeOptics)[name]
    shown = {"label": for_window(found.label), "tooltip": found.sentence, **more}
    return {**shown, "step": found.step} if found.kind == "number" else shown


def simulate_cells(
    cells: Annotated[int, {"min": 1, "max": 500}] = 4,
    kind: CellKind = "foam",
    shape: tuple[int, int, int] = (40, 64, 64),
    voxel_size: Annotated[
        Lengths, {"label": "voxel, µm", "options": {"step": 0.01, "min": 0.001}}
    ] = (0.3, 0.2, 0.2),
    psf: Annotated[
        Literal["Gaussian", "widefield", "confocal", "spinning disk"], {"label": "PSF"}
    ] = "Gaussian",
    sigma: Annotated[Lengths, {"label": "sigma, µm", "options": {"step": 0.01, "min": 0.001}}] = (
        0.4,
        0.24,
        0.24,
    ),
    na: Annotated[float, _said("na", min=0.0)] = 0.8,
    wavelength: Annotated[float, _said("wavelength", min=0.0, max=1e5)] = 0.52,
    immersion: Annotated[str, _said("immersion", choices=list(IMMERSIONS))] = "water",
    interior: Annotated[
        float, {"label": "fill, 1/µm", "step": 0.05, "min": 0.0, "max": 100.0}
    ] = 0.0,
    effects: str = "none",
    photons: Annotated[float, {"min": 0.1, "max": 60_000.0}] = 100.0,
    background: Annotated[float, {"min": 0.0, "max": 60_000.0}] = 10.0,
    seed: Annotated[int, {"min": 0, "max": 2**31 - 1}] = 0,
) -> FunctionWorker[list[LayerDataTuple]]:
    """Simulate an image of random cells, and show it with their true surfaces and labels.

    Parameters
    ----------
    cells
        Number of cells.
    kind
        Cells of a foam share walls; vesicles lie apart.
    shape
        Size of the image in voxels, Z Y X.
    voxel_size
        Size of a voxel, um, Z Y X.
    psf
        A Gaussian, or the PSF of a microscope.
    sigma
        Standard deviations of a Gaussian PSF, um, Z Y X.
    interior
        Light inside cells: fluorophores per um^3, for one per um^2 of membrane.
    effects
        Effects with their numbers, such as attenuation=0.02,halo=0.1,camera:gain=2:offset=100.
    photons
        Photons in the brightest voxel, on top of the background.
    background
        Photons of the background in every voxel.
    seed
        Random seed of cells and noise; the same seed gives the same image.
    """
    grid = Grid(shape, voxel_size)
    chosen = Effects.from_text(effects)
    optics: Optics = (
        GaussianPSF(sigma)
        if psf == "Gaussian"
        else microscope(psf, na=na, wavelength=wavelength, immersion=immersion)
    )

    def work() -> list[Any]:
        mesh = random_cells(cells, grid, kind, seed)
        scene = Scene(membranes_and_insides(mesh, interior), optics, chosen)
        made = simulate(scene, grid, photons=photons, background=background, seed=seed)
        return layers_of(made, f"simulated {kind}, seed {seed}")

    return _in_thread(work)


def _tend(widget: Any) -> None:
    """Show only the fields of the chosen kind of PSF, and errors as a sentence."""

    def show(psf: str) -> None:
        widget.sigma.visible = psf == "Gaussian"
        for name in ("na", "wavelength", "immersion"):
            widget[name].visible = psf != "Gaussian"

    widget.psf.changed.connect(show)
    show(widget.psf.value)
    _press_in_words(widget)


simulate_widget = magic_factory(simulate_cells, widget_init=_tend, call_button="Simulate")


def layers_of(made: Simulation, name: str) -> list[Any]:
    """The simulated image, true surfaces and true labels as layers."""
    um: dict[str, Any] = {"units": ("um",) * 3, "axis_labels": ("z", "y", "x")}
    voxels = {**um, "scale": made.grid.voxel_size, "translate": made.grid.origin}
    layers: list[Any] = [(made.image, {**voxels, "name": name}, "image")]
    mesh, truth = made.mesh, {"metadata": {OWN: {TRUTH: True}}, "visible": False}
    if mesh is not None:
        surface = mesh.vertices_numpy(), mesh.faces, vertex_values(mesh)
        look = {**um, **surface_look(), **truth, "name": f"{name}: true surfaces"}
        look["metadata"] = {OWN: {"regions": mesh.regions, TRUTH: True}}
        layers.append((surface, look, "surface"))
    look = {**voxels, **truth, "name": f"{name}: true labels", "opacity": 0.3}
    return [*layers, (made.labels, look, "labels")]
