"""The numbers that decided in a fit besides the settings of its run; kept with each result.

Such numbers are in *rules*: frozen dataclasses whose docstrings give the unit and the source of
each number. Unlike settings, rules cannot be changed by a caller, but they may differ between
versions. All rules of the packages below are kept.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from functools import cache
from importlib import import_module
from pkgutil import walk_packages
from types import ModuleType
from typing import Any

from ..fitting.objective.schedule import Schedule

_ROOMS = ("images", "geometry.labels", "optics", "fitting", "evidence")
# Titles of rules that are not named after their module (RULES) or after themselves (others).
_NAMES = {
    "finding": "cells",
    "whole cells": "markers",
    "spectrum": "first PSF",
    "shape dial": "shape",
    "voxel ownership": "voxels that count",
    "ground again": "voxels that count, asked again",
    "likelihood": "weights",
    "triangle quality": "triangles",
    "growth alarm": "growth",
    "structure choice": "structure",
    "evening": "uneven insides",
    "rival structures": "rivals",
    "narrow": "narrow PSFs",
    "lit surroundings": "local background, tried",
    "psf tails": "tails of the PSF",
    "unseeded objects": "strays",
    "refits": "changed images",
    "noise blur": "noise",
    "slices apart": "slices",
    "slices": "slices of the image",
    "compressed brightness": "logarithms",
    "verdict rules": "verdict",
}


@cache
def rules_of_a_fit() -> dict[str, dict[str, Any]]:
    """Return the numbers of each set of rules, by its name."""
    found = {"schedule": asdict(Schedule())}
    for module in _modules():
        last = module.__name__.rpartition(".")[2]
        for name, value in vars(module).items():
            kind = type(value)
            if kind.__module__ == module.__name__ and kind.__name__.endswith("Rules"):
                usual = (last if name == "RULES" else name.lower()).replace("_", " ")
                found[_NAMES.get(usual, usual)] = asdict(value)
    return found


def _modules() -> Iterator[ModuleType]:
    for room in _ROOMS:
        package = import_module(f"...{room}", __name__)
        for file in walk_packages(package.__path__, f"{package.__name__}."):
            yield import_module(file.name)
