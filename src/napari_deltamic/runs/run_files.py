"""Files for what only the viewer holds of a run, so that a command can repeat the run."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..geometry.formats import MESH_FILES
from ..images.stacks import holds_image, write_image
from ..scene import Grid
from .command import command
from .seeds import Seeds
from .settings import NEAR_LEVELS, RunSettings


@dataclass(frozen=True, eq=False)
class Chosen:
    """A run as chosen in the window; ``second`` is the image of its second view, if any."""

    settings: RunSettings
    pixels: NDArray[Any]
    grid: Grid
    seeds: Seeds
    second: NDArray[Any] | None = None

    def compared(self) -> Chosen:
        """The same run, without the paths of images that were edited since they were opened."""
        settings, view = self.settings, self.settings.scene.effects.view
        if settings.image and not holds_image(settings.image, self.pixels, settings.channel):
            settings = settings.model_copy(update={"image": ""})
        second = self.second
        if view and view.image and second is not None and not holds_image(view.image, second):
            settings = with_second_file(settings, "")
        return replace(self, settings=settings)

    def command(self, folder: str) -> str:
        """The command line that repeats the run; what has no file yet is written to the folder."""
        settings, pixels = self.settings, self.pixels
        if folder:
            where = Path(folder)
            settings = with_files(settings, pixels, self.grid, self.seeds, where, self.second)
        output = str(Path(settings.seeds).with_name("result"))
        missing = bool(np.isnan(pixels).any()) if pixels.dtype.kind == "f" else False
        return command(settings, output, missing=missing)


def needs_folder(settings: RunSettings) -> bool:
    """Whether an image or seeds live only in the viewer, so that they must be saved first."""
    view = settings.scene.effects.view
    return not (settings.image and settings.seeds and (view is None or view.image))


def with_second_file(settings: RunSettings, path: str) -> RunSettings:
    """The settings with another file for their second view."""
    scene = settings.scene
    view = scene.effects.view
    assert view is not None, "the settings have a second view"
    effects = scene.effects.adding(view.model_copy(update={"image": path}))
    scene = scene.model_copy(update={"effects": effects})
    return settings.model_copy(update={"scene": scene})


def with_files(
    settings: RunSettings,
    image: NDArray[Any],
    grid: Grid,
    seeds: Seeds,
    folder: Path,
    second: NDArray[Any] | None = None,
) -> RunSettings:
    """The settings after writing files for what has none; InputError if that fails."""
    files: dict[str, str | None] = {"image": settings.image, "seeds": settings.seeds}
    if not files["image"]:
        path = _unused(folder / "image.tif")
        write_image(path, image, grid.voxel_size)
        files |= {"image": str(path.absolute()), "channel": None}
    if not files["seeds"]:
        path = seeds.save(folder, image, grid)
        files["seeds"] = str(path.absolute())
        if path.suffix in MESH_FILES and seeds.kind != "rough" and settings.fit.levels is None:
            # A mesh file does not record that its surfaces already lie on the membranes.
            fit = settings.fit.model_copy(update={"levels": NEAR_LEVELS})
            settings = settings.model_copy(update={"fit": fit})
    settings = settings.model_copy(update=files)
    view = settings.scene.effects.view
    if view is not None and not view.image and second is not None:
        path = _unused(folder / "second.tif")
        write_image(path, second, grid.voxel_size)
        settings = with_second_file(settings, str(path.absolute()))
    return settings


def _unused(path: Path) -> Path:
    """A path that is not in use yet: the folder may be that of the user's own images."""
    found, k = path, 0
    while found.exists():
        k += 1
        found = path.with_stem(f"{path.stem}-{k}")
    return found
