"""What computing costs on this machine: measured once in about a second, and kept on disk.

Only forecasts depend on it: how an image is rendered is chosen with built-in costs.
"""

from __future__ import annotations

import json
import os
import platform
from dataclasses import asdict, fields
from functools import cache
from pathlib import Path
from typing import Any

from ..common.cache_folder import cache_folder
from ..common.writing import write_if_possible
from ..errors import InputError
from ..fourier.cost import BUILT_IN, Costs, Rates, Work, built_in
from ..fourier.native import simd_level, threads
from .calibration import calibrate

_FORMAT = 2  # of the file; raised when what is measured changes

_known: dict[tuple[str, int], Costs] = {}  # in this process, by file and threads


def costs(measure: bool = False, again: bool = False) -> Costs:
    """The costs of this machine: those kept from an earlier measurement, if there are any.

    Parameters
    ----------
    measure
        Whether to measure (:func:`calibrate`) where nothing is kept, or what is kept belongs to
        another machine or version; otherwise ``BUILT_IN`` is used. Rendering and fitting never
        measure: they take the same time and make the same choices whether or not it was done.
    again
        Whether to measure even if something is kept, which may be from a busy moment.
    """
    path = costs_file()
    key = (str(path), threads())
    if key in _known and not again and (_known[key].measured or not measure):
        return _known[key]
    found = None if again else _read(path)
    if again or (found is None and measure):
        found = calibrate()
        text = json.dumps({"of": _whose(), "costs": asdict(found)}, indent=1) + "\n"
        write_if_possible(path, text)
    _known[key] = found or BUILT_IN
    return _known[key]


def costs_file() -> Path:
    """The file in which the costs are kept, one for each number of threads."""
    return cache_folder() / f"costs-{threads()}.json"


def expected_seconds(work: Work, single: bool, device: str = "cpu") -> float:
    """Seconds of one rendering with its gradient, at this machine's costs where they are known."""
    known = costs() if device == "cpu" else built_in(device)
    return known.seconds(work, single)


def _whose() -> dict[str, Any]:
    """What costs depend on: they are stale if any of these has changed."""
    from ..common.version import __version__  # only here, as it takes longer than the rest

    try:
        level = simd_level()
    except InputError:
        level = "unknown"
    return {
        "format": _FORMAT,
        "version": __version__,
        "machine": f"{platform.system()} {platform.machine()}, {processor()}",
        "cores": os.cpu_count(),
        "threads": threads(),
        "instructions": level,
    }


@cache
def processor() -> str:
    """Name of the processor, as far as the system gives it."""
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine() or "unknown"


def _read(path: Path) -> Costs | None:
    """The costs in a file; None if it is missing, damaged, or from another machine or version."""
    try:
        kept = json.loads(path.read_text(encoding="utf-8"))
        if kept["of"] != _whose():
            return None
        return _from_plain(kept["costs"])
    except (OSError, ValueError, TypeError, KeyError):
        return None


def _from_plain(plain: dict[str, Any]) -> Costs:
    """Costs from plain values; ValueError, TypeError or KeyError if these are not costs."""
    values: dict[str, Any] = {}
    for f in fields(Costs):
        value = plain[f.name]
        if isinstance(value, dict):
            value = Rates(**{r.name: _cost(value[r.name]) for r in fields(Rates)})
        elif f.name != "measured":
            value = _cost(value)
        values[f.name] = value
    return Costs(**values)


def _cost(value: Any) -> float:
    if not 0 <= float(value) < 1:  # seconds for a unit of anything
        raise ValueError(f"{value} is no cost")
    return float(value)
