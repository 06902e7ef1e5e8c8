"""``napari-deltamic measure``: tables and files of what is measured on a mesh."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..common.writing import own_folder, write_atomically
from ..errors import InputError, failure
from ..images.stacks import read_image
from ..measure import Table, measure
from ..measure.channel import ChannelSettings, channel_amounts
from ..measure.channel_tables import channel_tables
from ..optics import GaussianPSF
from ..results.html_page import html_page
from ..results.lineage_graph import GEFF, write_geff
from ..results.measured_files import write_measurements
from ..results.measured_source import Measurable, Triple, measurable
from ..results.track_report import holds_tracks, read_results, tracks_csv
from .messages import Notes, tell


def run(arguments: argparse.Namespace, notes: Notes) -> int:
    """Read, measure, write; prints the path of each result."""
    folder = Path(arguments.output)
    if holds_tracks(arguments.source):
        return _tracks(Path(arguments.source), folder, notes)
    try:
        source = measurable(
            arguments.source, arguments.image, _triple(arguments.voxel_size), arguments.errors
        )
        for remark in source.remarks:
            notes.add(remark)
        further = () if arguments.channel is None else _channel(arguments, source, notes)
        measured = measure(source.mesh, source.known)
        with own_folder(folder):
            notes.release()
            size = _triple(arguments.label_voxel)
            paths = write_measurements(
                folder,
                source.mesh,
                measured,
                grid=source.grid,
                voxel_size=size,
                page=html_page(source, measured),
                further=further,
            )
    except (MemoryError, RuntimeError) as error:
        raise failure(error) from error
    for path in paths:
        tell(path)
    return 0


def _tracks(source: Path, folder: Path, notes: Notes) -> int:
    """What ``track`` wrote, as a table and as a graph for other tools."""
    results = read_results(source)
    with own_folder(folder):
        notes.release()
        table = folder / "tracks.csv"
        paths = [write_geff(folder / GEFF, results), table]
        write_atomically(table, tracks_csv(results).encode())
    for path in paths:
        tell(path)
    return 0


def _channel(arguments: argparse.Namespace, source: Measurable, notes: Notes) -> tuple[Table, ...]:
    """The tables of another channel."""
    if source.grid is None:
        raise InputError("--channel needs the image of the mesh: give --image")
    sigma = _triple(arguments.channel_sigma) or source.sigma
    if sigma is None:
        raise InputError("--channel needs the widths of its PSF: give --channel-sigma Z Y X")
    on = arguments.channel_on
    settings = ChannelSettings(walls=on != "insides", insides=on != "walls")
    pixels, _ = read_image(arguments.channel)
    try:
        found = channel_amounts(pixels, source.grid, source.mesh, GaussianPSF(sigma), settings)
    except InputError as error:
        raise InputError(f"{arguments.channel}: {error}") from None
    shift, widths = (" ".join(f"{v:.3f}" for v in t) for t in (found.shift, found.sigma))
    notes.add(
        f"the channel lies {shift} um (Z Y X) beside the mesh, its PSF is {widths} um wide, and "
        f"{100 * found.explained:.0f} % of it are explained"
    )
    return channel_tables(source.mesh, found)


def _triple(values: list[float] | None) -> Triple | None:
    if values is None:
        return None
    z, y, x = values
    return z, y, x
