"""Puts a fit together from its settings; the image tells what they leave open."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numpy.typing import NDArray

from ..fitting.job import FitInput, assemble, levelled
from ..geometry import Mesh
from ..runs.seeds import SeedKind, Seeds
from ..runs.settings import RunSettings, SceneSettings
from ..scene import Grid
from .first_sigma import with_first_psf
from .tilted_ground import with_ground

Start = Callable[[NDArray[Any], Grid], tuple[Mesh, SeedKind]]


def put_together(
    settings: RunSettings,
    image: NDArray[Any],
    grid: Grid,
    start: Start,
    *,
    tell: Callable[[SceneSettings, str, bool], None] | None = None,
    second: NDArray[Any] | None = None,
    ground: bool = True,
) -> FitInput:
    """A fit that is ready to run. May take seconds.

    Parameters
    ----------
    image : (Z, Y, X); NaN where missing.
    start : makes the mesh, from the image without what effects add to it, and says how near to
        the membranes it lies.
    tell : called before that with the scene to be fitted; a sentence on its background, '' where
        that is even; and whether the image told how wide the PSF is.
    second : (Z, Y, X) second view, where it is in no file.
    ground : whether the background may be found uneven.

    Raises
    ------
    InputError
        Where something cannot be used.
    """
    scene, uneven = with_ground(settings.scene, image) if ground else (settings.scene, "")
    level = levelled(image, grid, scene.effects)
    scene, told = with_first_psf(scene, level)
    if tell is not None:
        tell(scene, uneven, told)
    mesh, kind = start(level, grid)
    whole = settings.model_copy(update={"scene": scene})
    return assemble(whole, image, grid, mesh, kind, second)


def start_of(seeds: Seeds, image: NDArray[Any], grid: Grid) -> tuple[Mesh, SeedKind]:
    """Starting surfaces, and how near to the membranes they lie."""
    return seeds.make(image, grid), seeds.kind
