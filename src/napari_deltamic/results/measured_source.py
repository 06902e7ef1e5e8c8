"""Reads what can be measured: a mesh file, a session, or the folder of a fit."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..common.choices import IMAGE_FILES
from ..common.description import described
from ..common.triple import Triple, geometric_mean
from ..errors import InputError
from ..evidence import analyse_residual
from ..geometry import Mesh, load_mesh
from ..geometry.judgement import Judgement
from ..images.missing import finite_or_nan
from ..images.padding import without_padding
from ..images.stacks import read_image
from ..measure import Known
from ..measure.of_fit import known_of, replicas_at
from ..runs.settings import RunSettings
from ..scene import Grid
from .session_file import EXTENSION, load_session

_T = TypeVar("_T")
_FLAG = described(RunSettings)["channel"].flag
# Size of a whole mesh, um; chosen: no light microscope shows smaller things or sees larger ones.
_SMALLEST, _LARGEST = 0.05, 1e5


@dataclass(frozen=True, eq=False)
class Measurable:
    """A mesh, and what else is known.

    name : of the file or folder.
    grid, image : those that it was fitted to, if known.
    rendered : (Z, Y, X) the image that the fit expects; None if not known.
    sigma : um, Z Y X; widths of the PSF, if known.
    facts : plain values about the fit: settings, verdict, versions.
    remarks : a sentence for each thing that could not be found.
    file : path of the image; "" if it is in no file of its own.
    """

    name: str
    mesh: Mesh
    known: Known
    grid: Grid | None = None
    image: NDArray[Any] | None = None
    rendered: NDArray[Any] | None = None
    sigma: Triple | None = None
    facts: Mapping[str, Any] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    file: str = ""


def measurable(
    path: str | Path,
    image: str | Path | None = None,
    voxel_size: Triple | None = None,
    errors: bool = False,
    channel: str | None = None,
) -> Measurable:
    """Read what is to be measured.

    Parameters
    ----------
    path
        A mesh file, a session (.deltamic), or the folder that ``fit`` wrote.
    image
        The image that a mesh was fitted to, if the source does not hold it.
    voxel_size
        um, of that image, if its file does not say it.
    errors
        Whether standard errors are computed, which takes about as long as a fit. Only a session
        holds what they need.
    channel
        Of that image, by number or name; None for the one that was fitted, or the only one.

    Raises
    ------
    InputError
        If a file is missing or damaged, or holds nothing to measure.
    """
    path = Path(path)
    if path.suffix.lower() == EXTENSION:
        if image is not None:
            raise InputError(f"{path.name} holds its image: leave out --image")
        if channel is not None:
            raise InputError(f"{path.name} holds one channel only: leave out --channel")
        if voxel_size is not None:
            raise InputError(f"{path.name} holds its voxel size: leave out --voxel-size")
        return _of_session(path, errors)
    if errors:
        raise InputError("standard errors need a session: save one in the window")
    if path.is_dir():
        return _of_folder(path, image, voxel_size, channel)
    if image is None and (voxel_size is not None or channel is not None):
        raise InputError(
            "--voxel-size and --channel need --image: leave them out, as a mesh is in um"
        )
    mesh = load_mesh(path)
    plain = Measurable(path.name, mesh, Known(), remarks=_about_unit(mesh))
    return _with_image(plain, image, voxel_size, channel)


def _with_image(
    found: Measurable,
    image: str | Path | None,
    voxel_size: Triple | None,
    channel: str | None = None,
) -> Measurable:
    """Add an image and its grid; the mesh's origin is taken to be the centre of its first voxel."""
    if image is None:
        return _without_image(found)
    pixels, stored = read_image(image, channel, _FLAG)
    pixels = finite_or_nan(without_padding(pixels)[0])
    size = voxel_size or stored
    if size is None:
        raise InputError(f"{Path(image).name} does not say its voxel size: give --voxel-size Z Y X")
    z, y, x = pixels.shape
    grid = Grid((z, y, x), size)
    _check_near(found.mesh, grid)
    return Measurable(found.name, found.mesh, Known(grid=grid), grid, pixels, file=str(image))


def _without_image(found: Measurable) -> Measurable:
    words = "no image: nothing is known of its border"
    return replace(found, remarks=(*found.remarks, words))


def _of_folder(
    path: Path, image: str | Path | None, voxel_size: Triple | None, channel: str | None
) -> Measurable:
    if not (path / "mesh.ply").is_file():
        raise InputError(f"{path}: no folder of a fit: it holds no mesh.ply")
    mesh = load_mesh(path / "mesh.ply")
    plain = Measurable(path.name, mesh, Known())
    if not (path / "run.toml").is_file():
        return _with_image(plain, image, voxel_size, channel)
    settings, report = RunSettings.from_toml(path / "run.toml"), _report(path / "report.json")
    rendered = None
    if (path / "rendered.tif").is_file():
        rendered, _ = read_image(path / "rendered.tif")
    sigma = _widths(report.get("optics"))
    known = Known(
        resolution=0.0 if sigma is None else geometric_mean(sigma),
        explained=_told(_explained, report.get("residual")),
        judgements=_told(_judgements, report.get("verdict")),
    )
    found = Measurable(path.name, mesh, known, sigma=sigma, facts=report)
    source, pixels = Path(image or settings.image), None
    if image is None and not (source.exists() and source.suffix.lower() in IMAGE_FILES):
        found = replace(found, remarks=(f"the image {source} no longer exists",))
        if rendered is None:
            return _without_image(found)
        shape = rendered.shape  # the measured image had the same
    else:
        pixels = read_image(source, channel or settings.channel, _FLAG)[0]
        pixels = finite_or_nan(without_padding(pixels)[0])
        shape = pixels.shape
        found = replace(found, file=str(source))
    z, y, x = shape
    grid = Grid((z, y, x), voxel_size or settings.scene.voxel_size, settings.scene.origin)
    _check_near(mesh, grid)
    if rendered is not None and rendered.shape != shape:
        rendered = None
    known = replace(known, grid=grid)
    return replace(found, known=known, grid=grid, image=pixels, rendered=rendered)


def _of_session(path: Path, errors: bool) -> Measurable:
    session = load_session(path)
    result, grid = session.result, session.image.grid
    if result is None:
        raise InputError(f"{path}: the session holds no result to measure")
    state, pixels = result.state, session.image.pixels
    explained, remarks = {}, []
    try:
        explained = analyse_residual(pixels, grid, state, counted=result.counted).shares()
    except InputError as error:
        remarks.append(f"what the fit explains is not known: {error}")
    replicas = (
        replicas_at(pixels, grid, state, result.settings.fit, result.counted) if errors else None
    )
    facts = {
        "settings": result.settings.model_dump(mode="json"),
        "message": result.message,
        "converged": state.converged,
        "iterations": state.iteration,
        "seconds": result.seconds,
        "optics": {"model": type(state.optics).__name__, "sigma_um": list(state.optics.sigma_um)},
    }
    return Measurable(
        path.name,
        state.mesh,
        known_of(state, grid, explained=explained, replicas=replicas),
        grid,
        pixels,
        state.rendered(),
        state.optics.sigma_um,
        facts,
        tuple(remarks),
    )


def _check_near(mesh: Mesh, grid: Grid) -> None:
    """InputError if mesh and image do not even touch: it is another image, or another unit."""
    low, high = mesh.bounds()
    first, last = grid.extent
    if (high < first).any() or (low > last).any():
        raise InputError("the mesh lies outside of the image: is it of this image, and in um?")


def _about_unit(mesh: Mesh) -> tuple[str, ...]:
    """Return a remark on a mesh whose numbers can hardly be um; nothing for others."""
    low, high = mesh.bounds()
    widest = float((high - low).max())
    if _SMALLEST <= widest <= _LARGEST:
        return ()
    return (f"the mesh is {widest:.3g} um wide: check that its coordinates are in um",)


def _report(path: Path) -> dict[str, Any]:
    """Return the report of a fit; empty if the file is missing or damaged."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def _told(read: Callable[[Any], dict[int, _T]], section: Any) -> dict[int, _T]:
    """Read what a section of a report says about each cell; empty if it is damaged."""
    try:
        return read(section)
    except (TypeError, ValueError):
        return {}


def _widths(optics: Any) -> Triple | None:
    """Return the PSF's widths from a report; None if it has none."""
    sigma = optics.get("sigma_um") if isinstance(optics, dict) else None
    try:
        z, y, x = (float(s) for s in sigma or ())
    except (TypeError, ValueError):
        return None
    return (z, y, x) if all(0 < s < np.inf for s in (z, y, x)) else None


def _explained(residual: Any) -> dict[int, float]:
    """Return the share explained around each cell, from a report."""
    cells = residual.get("cells") if isinstance(residual, dict) else None
    return {
        int(cell["region"]): float(cell["explained"])
        for cell in cells or ()
        if isinstance(cell, dict) and cell.get("explained") is not None and "region" in cell
    }


def _judgements(verdict: Any) -> dict[int, Judgement]:
    """Return how good the shape of each cell is, from a report."""
    cells = verdict.get("cells") if isinstance(verdict, dict) else None
    found = {}
    for cell in cells or ():
        if isinstance(cell, dict) and {"region", "grade"} <= set(cell):
            error, reasons = cell.get("shape_error_um"), cell.get("reasons") or ()
            found[int(cell["region"])] = Judgement(
                str(cell["grade"]),
                None if error is None else float(error),
                "; ".join(map(str, reasons)),
            )
    return found
