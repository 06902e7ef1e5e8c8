"""``napari-deltamic doctor``: what this machine offers, and what would be used and why."""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
import warnings
from math import prod
from typing import Any

import torch

from .. import __version__
from ..accuracy.machine_costs import costs, expected_seconds, processor
from ..common.version import version_of
from ..common.words import duration
from ..errors import InputError
from ..fourier import Plan, native, simd_level
from ..fourier.cuda import compiler, missing
from ..fourier.cuda.driver import driver_version
from ..fourier.devices import choose_device
from ..fourier.native import threads
from ..fourier.plan import Method
from ..geometry import sphere
from ..optics import GaussianPSF
from ..results.report import PACKAGES
from ..scene import Grid, Renderer, Scene
from .messages import Notes

EXTRAS = ("trimesh", "tifffile", "pydantic", "napari", "PyQt6", "cuda-bindings")
VARIABLES = ("DELTAMIC_SIMD", "OMP_NUM_THREADS", "OMP_WAIT_POLICY", "MKL_NUM_THREADS")


def run(arguments: argparse.Namespace, notes: Notes) -> int:
    """Print what is found, with problems on lines of their own."""
    facts = examine()
    if arguments.json:
        print(json.dumps(facts, indent=2))
        return 0
    for title, items in facts.items():
        print(title)
        lines = items.items() if isinstance(items, dict) else enumerate(items, 1)
        for name, text in lines:
            print(f"  {name}: {text}")
        if not items:
            print("  none found")
    return 0


def examine() -> dict[str, Any]:
    """What ``doctor`` prints: titles -> names -> texts, and a list of problems."""
    problems: list[str] = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about drivers and the extension: both are reported below
        devices = _devices(problems)
        engines = _engines(problems)
        used = _used()
    return {
        "versions": _versions(),
        "devices": devices,
        "engines": engines,
        "threads": _threads(),
        "used": used,
        "problems": problems,
    }


def _versions() -> dict[str, str]:
    found = {"napari-deltamic": __version__, "python": platform.python_version()}
    found["system"] = f"{platform.system()} {platform.machine()}"
    for package in (*PACKAGES[1:], *EXTRAS):
        found[package] = version_of(package, "not installed")
    return found


def _devices(problems: list[str]) -> dict[str, str]:
    found = {"cpu": f"{processor()}, {os.cpu_count()} cores"}
    reason = missing()
    if torch.cuda.is_available():
        for i in range(torch.cuda.device_count()):
            used = (
                f"not used: {reason}" if reason else "used for large images, 100^3 voxels and more"
            )
            used = used if i == 0 or reason else "not used: the first one is"
            found[f"cuda:{i}"] = f"{torch.cuda.get_device_name(i)} ({used})"
        if reason:
            problems.append(f"there is a GPU, but it is not used: {reason}")
    elif driver_version() is not None:
        found["cuda"] = f"an NVIDIA GPU, not used: {reason}"
        problems.append(f"there is a GPU, but it is not used: {reason}")
    else:
        found["cuda"] = f"none ({reason})"
    if torch.backends.mps.is_available():
        found["mps"] = "there; forms images where asked for (--device mps)"
    return found


def _engines(problems: list[str]) -> dict[str, str]:
    found: dict[str, str] = {}
    if not missing():
        major, minor = compiler.version()
        for method in ("closed form", "particle-mesh"):
            found[f"{method} on the GPU"] = (
                f"compiled at first use by NVRTC {major}.{minor}, kept in {compiler.kept_folder()}"
            )
    module = native()
    if module is None:
        found["closed form"] = found["particle-mesh"] = "torch: the compiled extension is missing"
        problems.append(
            "the compiled extension is missing: images are computed in torch, 8 to 10 times "
            "slower by the particle-mesh, 40 to 150 times by the closed form; to get it back, "
            "reinstall with a C++ compiler and --no-cache-dir"
        )
        return found
    levels = list(module.simd_levels())
    try:
        level = simd_level()
    except InputError as error:
        problems.append(str(error))
        found["closed form"] = f"compiled; {', '.join(levels)}"
        return found
    why = "DELTAMIC_SIMD" if os.environ.get("DELTAMIC_SIMD") else "the best one here"
    found["closed form"] = f"compiled; of {', '.join(levels)} it uses {level} ({why})"
    found["particle-mesh"] = "compiled, as the closed form"
    return found


def _threads() -> dict[str, str]:
    allowed = len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count()
    found = {"used": f"{threads()}, as torch was told", "cores for this process": str(allowed)}
    for name in VARIABLES:
        if name in os.environ:
            found[name] = os.environ[name]
    return found


def _used() -> dict[str, str]:
    """The engine that a scene of usual size gets, and why: the time that each engine takes."""
    grid = Grid((100, 100, 100), (0.1, 0.1, 0.1))
    mesh = sphere((5, 5, 5), 3.0, subdivisions=4)
    optics = GaussianPSF(0.15)
    found = {"scene": f"100 x 100 x 100 voxels, sigma 1.5 voxels, {len(mesh.faces)} faces"}
    device = choose_device(voxels=prod(grid.shape))
    found["device"] = str(device)
    where = "here, as was measured" if costs().measured else "on one core of 2024"
    for accuracy in (1e-2, 1e-3, 1e-5):
        plan = Renderer(Scene.of(mesh, optics), grid, accuracy, device=device).plan
        other: Method = "closed form" if plan.method == "particle-mesh" else "particle-mesh"
        rest = Renderer(Scene.of(mesh, optics), grid, accuracy, method=other, device=device).plan
        found[f"accuracy {accuracy:g}"] = (
            f"{plan.method}: about {_time(plan)} an iteration {where}; {rest.method}: {_time(rest)}"
        )
    found["accuracy 0"] = "closed form at every wavevector: it is exact"
    return found


def _time(plan: Plan) -> str:
    return duration(expected_seconds(plan.work, plan.single, plan.device))
