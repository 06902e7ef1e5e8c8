"""Channel names as image files give them: OME, ImageJ, colours, OME-Zarr."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any
from xml.etree import ElementTree

import tifffile

_COLOURS = ("red", "green", "blue", "alpha")
_LONGEST = 40  # letters of a name; more is a header that some program stored in its place
# What Bio-Formats and Fiji put before the name in the label of a plane.
_PLACE = re.compile(r"^(?:[czt]:\d+/\d+\s*)+(?:-\s*)?")


def tiff_channel_names(tif: tifffile.TiffFile) -> tuple[str, ...]:
    """A name for each channel of the first series; () where the file gives none."""
    series = tif.series[0]
    counts = dict(zip(series.axes, series.shape, strict=False))
    colours = counts.get("S", 1)
    if "C" not in counts and 1 < colours <= len(_COLOURS):
        return _COLOURS[:colours]
    count = counts.get("C", 1)
    names = _ome_names(tif) if tif.is_ome else _imagej_names(tif, count) if tif.is_imagej else ()
    return known_names(names, count)


def zarr_channel_names(facts: Mapping[str, Any]) -> tuple[str, ...]:
    """The channel labels in the attributes of an OME-Zarr image; () where there are none."""
    omero = facts.get("omero")
    channels = omero.get("channels") if isinstance(omero, Mapping) else None
    if not isinstance(channels, list):
        return ()
    told = (channel.get("label") if isinstance(channel, Mapping) else "" for channel in channels)
    return tuple(str(name or "") for name in told)


def known_names(names: Iterable[str], count: int) -> tuple[str, ...]:
    """Names, each in one short line; () unless there is one per channel, and not all are empty."""
    plain = tuple(" ".join(name.split())[:_LONGEST] for name in names)
    return plain if len(plain) == count and any(plain) else ()


def _ome_names(tif: tifffile.TiffFile) -> tuple[str, ...]:
    try:
        root = ElementTree.fromstring(tif.ome_metadata or "")
    except ElementTree.ParseError:
        return ()
    pixels = next((e for e in root.iter() if e.tag.endswith("}Pixels")), None)
    channels = [e for e in pixels or () if e.tag.endswith("}Channel")]
    return tuple(e.get("Name") or e.get("Fluor") or "" for e in channels)


def _imagej_names(tif: tifffile.TiffFile, count: int) -> tuple[str, ...]:
    """Labels of the first slice's planes; () unless the next slice repeats them."""
    labels = (tif.imagej_metadata or {}).get("Labels")
    if not isinstance(labels, list) or len(labels) < count:
        return ()
    plain = [_PLACE.sub("", str(label).partition("\n")[0].strip()) for label in labels]
    first, second = plain[:count], plain[count : 2 * count]
    return tuple(first) if len(set(first)) == count and second in ([], first) else ()
