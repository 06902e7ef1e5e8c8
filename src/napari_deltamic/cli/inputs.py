"""From the arguments of ``fit`` to what the engine takes: settings, image, grid, mesh, PSF."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..common.ball import ball_radius
from ..common.choices import AUTO, is_auto
from ..common.description import described
from ..errors import InputError, NoCellsFound
from ..evidence.put_together import put_together, start_of
from ..fitting.job import FitInput
from ..fitting.model.checks import check_image
from ..geometry import Mesh
from ..geometry.mesh import FloatArray
from ..images.missing import finite_or_nan
from ..images.padding import without_padding
from ..images.stacks import SIZES_AGREE, read_image
from ..images.stored import VoxelSize
from ..runs.scene_settings import SIGMA_IN_VOXELS
from ..runs.seeds import SeedKind, seeds_of
from ..runs.settings import FitSettings, RunSettings, SceneSettings, validated
from ..scene import Grid
from ..scene.effects import Effects
from .flags import values_given
from .messages import Notes
from .optics_arguments import optics_values
from .second_view_input import with_second_view

CHANNEL = described(RunSettings)["channel"].flag


def gather(arguments: argparse.Namespace, notes: Notes) -> FitInput:
    """Read everything that a fit needs; InputError if something cannot be used."""
    values = run_values(arguments, notes)
    image, found = read_image(values["image"], values.get("channel"), CHANNEL)
    scene = values["scene"]
    scene["voxel_size"] = voxel_size_of(scene.get("voxel_size"), found, values["image"], notes)
    settings: RunSettings = validated(RunSettings, values)
    image, padded = without_padding(usable(image, arguments.missing_nan, notes))
    if padded:
        notes.add(f"{Path(settings.image).name}: {padded}")
    grid = Grid(image.shape, settings.scene.voxel_size, settings.scene.origin)
    check_image(image, grid)
    # "none" is meant literally; a requested background may start as the image shows it.
    wanted = arguments.effects in (None, AUTO) or bool(settings.scene.effects.present())
    ground = wanted and not arguments.settings
    return fit_of(settings, image, grid, notes, ground=ground)


def fit_of(
    settings: RunSettings, image: NDArray[Any], grid: Grid, notes: Notes, *, ground: bool
) -> FitInput:
    """The inputs of a fit, with notes on what was left open; see ``put_together``."""

    def tell(scene: SceneSettings, uneven: str, told: bool) -> None:
        if uneven:
            notes.add(f"{uneven}; --effects none would not")
        if settings.scene.sigma is None and settings.scene.optics is None:
            how = "as wide as the blur of the image" if told else f"{SIGMA_IN_VOXELS} voxels"
            held = "used; --fit-psf would fit it"
            use = "where the fit of the PSF starts" if settings.fit.fit_psf else held
            notes.add(f"no sigma given: {_shown(scene.sigma)} um (Z Y X), {how}, is {use}")

    def start(image: NDArray[Any], grid: Grid) -> tuple[Mesh, SeedKind, FloatArray | None]:
        found = load_seeds(settings.seeds, settings.image, image, grid)
        if is_auto(settings.seeds):
            notes.add(_what_was_found(settings.seeds, found[0]))
        return found

    return put_together(settings, image, grid, start, tell=tell, ground=ground)


def _what_was_found(path: str, cells: Mesh) -> str:
    """A sentence on how many cells were found, how large, and how to look for other sizes."""
    volumes = list(cells.volumes().values())
    across = float(np.median(2 * ball_radius(volumes)))
    number = "1 cell was found," if len(volumes) == 1 else f"{len(volumes)} cells were found, most"
    plain = path.partition(":")[0]
    return f"{number} about {across:.2g} um across ({plain}:12 looks for cells of about 12 um)"


def load_seeds(
    path: str, file: str, image: NDArray[Any], grid: Grid
) -> tuple[Mesh, SeedKind, FloatArray | None]:
    """Starting surfaces, read or found; see ``start_of``. file : path of the image.

    Raises
    ------
    InputError
        As the readers raise it; it names the file.
    """
    seeds = seeds_of(path, file)
    try:
        return start_of(seeds, image, grid)
    except NoCellsFound as error:
        how = f"{path.partition(':')[0]}:12 looks for cells of about 12 um"
        raise InputError(f"{path}: {error} ({how})") from None
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def run_values(
    arguments: argparse.Namespace, notes: Notes, model: type[RunSettings] = RunSettings
) -> dict[str, Any]:
    """The run settings as plain values: the arguments override those of a file, if given."""
    values: dict[str, Any] = {"scene": {}, "fit": {}}
    if arguments.settings:
        values = model.from_toml(arguments.settings).model_dump()
    for name in ("image", "seeds"):
        given = getattr(arguments, name)
        if given is not None:
            # Absolute, so that run.toml can be used from any folder.
            values[name] = given if is_auto(given) else str(Path(given).absolute())
    values |= values_given(arguments, RunSettings, ("channel",))
    values["fit"] |= values_given(arguments, FitSettings)
    values["scene"] |= values_given(arguments, SceneSettings, ("voxel_size", "sigma"))
    optics = optics_values(arguments)
    if optics is not None:
        values["scene"] |= {"sigma": None, "optics": optics}
    elif arguments.sigma is not None:
        values["scene"]["optics"] = None
    if arguments.effects is not None:
        if arguments.effects == "auto" and model is not RunSettings:
            notes.add("effects: 'auto' adds none to a series; 'effects' says which a frame needs")
        # The effects that an image calls for are added after a fit without them.
        text = "none" if arguments.effects == "auto" else arguments.effects
        effects, before = Effects.from_text(text), values["scene"].get("effects")
        view = None if before is None else validated(Effects, before).view
        if view is not None and effects.view is None:
            effects = effects.adding(view)  # it is data, and has flags of its own
        values["scene"]["effects"] = effects
    with_second_view(values["scene"], arguments)
    return values


def voxel_size_of(given: Any, found: VoxelSize | None, path: str, notes: Notes) -> Any:
    """The voxel size given, else that of the file, with a note. InputError if there is none."""
    name = Path(path).name
    if given is not None:
        if (
            found is not None
            and np.shape(given) == (3,)
            and not np.allclose(given, found, SIZES_AGREE)
        ):
            notes.add(
                f"{name} says that its voxels are {_shown(found)} um (Z Y X); "
                f"{_shown(given)} um, as given, is used"
            )
        return given
    if found is None:
        raise InputError(f"{name} does not say its voxel size: give --voxel-size Z Y X (um)")
    notes.add(f"voxel size {_shown(found)} um (Z Y X), from the metadata of {name}")
    return found


def usable(image: NDArray[Any], missing_nan: bool, notes: Notes, frame: str = "") -> NDArray[Any]:
    """The image or frame, with NaN where not finite; InputError if that may not be left out."""
    if not np.issubdtype(image.dtype, np.floating):
        return image
    nan, infinite = int(np.isnan(image).sum()), int(np.isinf(image).sum())
    if not nan + infinite:
        return image
    counts = " and ".join(f"{n} {kind}" for n, kind in ((nan, "NaN"), (infinite, "infinite")) if n)
    if not missing_nan:
        voxels = "voxel" if nan + infinite == 1 else "voxels"
        where = frame or "the image"
        raise InputError(f"{where} holds {counts} {voxels}; --missing-nan leaves them out")
    where = frame and f" of {frame}"
    notes.add(f"{counts} of {image.size} voxels{where} are treated as missing")
    return finite_or_nan(image)


def _shown(values: Any) -> str:
    return " ".join(f"{float(v):.4g}" for v in values)
