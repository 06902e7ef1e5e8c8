"""``napari-deltamic measure``: measures a mesh, and writes tables and files."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..common.choices import IMAGE_FILES
from ..common.triple import Triple, triple
from ..common.writing import own_folder, write_atomically
from ..errors import InputError, failure
from ..evidence.residual import residual_map
from ..images.missing import finite_or_nan
from ..images.padding import without_padding
from ..images.stacks import SIZES_AGREE, read_image
from ..images.stored import VoxelSize
from ..measure import Table, measure
from ..measure.channel import ChannelSettings, channel_amounts
from ..measure.channel_tables import channel_tables
from ..optics import GaussianPSF
from ..results.html_page import html_page
from ..results.lineage_graph import GEFF, write_geff
from ..results.measured_files import write_measurements
from ..results.measured_source import Measurable, measurable
from ..results.mesh_exchange import about_place, labels_grid
from ..results.track_report import holds_tracks, read_results, tracks_csv
from .messages import Notes, tell


def run(arguments: argparse.Namespace, notes: Notes) -> int:
    """Read, measure and write; prints the path of each result."""
    folder = Path(arguments.output)
    if holds_tracks(arguments.source):
        _check_of_tracks(arguments)
        return _tracks(Path(arguments.source), folder, notes)
    try:
        source = measurable(
            arguments.source,
            arguments.image,
            _asked(arguments.voxel_size),
            arguments.errors,
            arguments.channel,
        )
        for remark in source.remarks:
            notes.add(remark)
        further = () if arguments.other_channel is None else _other(arguments, source, notes)
        images = _images(arguments, source)
        measured = measure(source.mesh, source.known)
        size = _asked(arguments.label_voxel)
        if size is not None:
            place = labels_grid(source.mesh, size, source.grid)
            if told := about_place(place, source.grid):
                notes.add(told)
        with own_folder(folder):
            notes.release()
            paths = write_measurements(
                folder,
                source.mesh,
                measured,
                grid=source.grid,
                voxel_size=size,
                page=html_page(source, measured),
                further=further,
                images=images,
                image_suffix=".ome.zarr" if arguments.images == "zarr" else ".ome.tif",
            )
    except (MemoryError, RuntimeError) as error:
        raise failure(error) from error
    for path in paths:
        tell(path)
    return 0


def _images(arguments: argparse.Namespace, source: Measurable) -> dict[str, NDArray[Any]]:
    """The rendered image and the residual, by name, if asked for; InputError if not possible."""
    if arguments.images is None:
        return {}
    if source.image is None or source.grid is None:
        raise InputError("--images needs the image of the mesh: give --image")
    if source.rendered is None or source.sigma is None:
        raise InputError("--images needs a session, or the folder of a fit with its rendered.tif")
    rendered = np.asarray(source.rendered, np.float32)
    left = residual_map(source.image, source.grid, rendered, GaussianPSF(source.sigma))
    return {"rendered": rendered, "residual": left}


def _check_of_tracks(arguments: argparse.Namespace) -> None:
    """Raise InputError for options that concern a single image."""
    for name in (
        "image",
        "channel",
        "voxel_size",
        "label_voxel",
        "other_channel",
        "images",
        "errors",
    ):
        if getattr(arguments, name):
            option = name.replace("_", "-")
            raise InputError(f"tracks become a table and a graph: leave out --{option}")


def _tracks(source: Path, folder: Path, notes: Notes) -> int:
    """Write the results of ``track`` as a table, and as a graph for other tools."""
    results = read_results(source)
    with own_folder(folder):
        notes.release()
        table = folder / "tracks.csv"
        paths = [write_geff(folder / GEFF, results), table]
        write_atomically(table, tracks_csv(results).encode())
    for path in paths:
        tell(path)
    return 0


def _other(arguments: argparse.Namespace, source: Measurable, notes: Notes) -> tuple[Table, ...]:
    """The tables of another channel; InputError if it cannot be measured."""
    if source.grid is None:
        raise InputError("--other-channel needs the image of the mesh: give --image")
    asked, sigma = arguments.other_channel, _asked(arguments.other_channel_sigma) or source.sigma
    if sigma is None:
        raise InputError("no widths of the PSF are known: give --other-channel-sigma Z Y X")
    on = arguments.other_channel_on
    settings = ChannelSettings(walls=on != "insides", insides=on != "walls")
    whole, size = _other_pixels(asked, source)
    if size is not None and not np.allclose(size, source.grid.voxel_size, rtol=SIZES_AGREE):
        own, used = (" ".join(f"{d:.4g}" for d in s) for s in (size, source.grid.voxel_size))
        notes.add(
            f"{Path(asked).name} gives a voxel size of {own} um (Z Y X); that of the image, "
            f"{used} um, is used instead"
        )
    pixels = finite_or_nan(without_padding(whole)[0])
    try:
        found = channel_amounts(pixels, source.grid, source.mesh, GaussianPSF(sigma), settings)
    except InputError as error:
        raise InputError(f"{asked}: {error}") from None
    shift, widths = (" ".join(f"{v:.3f}" for v in t) for t in (found.shift, found.sigma))
    notes.add(
        f"the channel is shifted by {shift} um (Z Y X), its PSF is {widths} um wide, and "
        f"{100 * found.explained:.0f} % of it are explained"
    )
    return channel_tables(source.mesh, found)


def _other_pixels(asked: str, source: Measurable) -> tuple[NDArray[Any], VoxelSize | None]:
    """Pixels and voxel size (um) of a file, or of a channel of the image the mesh was fitted to.

    The size is None for a channel of that image, whose size counts.
    """
    if Path(asked).suffix.lower() in IMAGE_FILES:
        return read_image(asked)
    if not source.file:
        raise InputError(
            f"--other-channel {asked}: no image file is known for this mesh: give the file of the "
            "channel"
        )
    return read_image(source.file, asked, "--other-channel")[0], None


def _asked(values: list[float] | None) -> Triple | None:
    return None if values is None else triple(values)
