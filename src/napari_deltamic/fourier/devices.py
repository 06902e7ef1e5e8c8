"""The choice of the device that computes."""

from __future__ import annotations

import torch

from ..common.choices import DeviceChoice
from ..errors import InputError
from .cuda import missing

# Time of a fit's iteration on an H100 and on two cores of a Xeon, measured (ms): 9.8 and 10.1 at
# 40^3 voxels, 9.4 and 16 at 64^3, 13 and 56 at 128^3, 16 and 181 at 200^3. The first iteration took
# 0.4 to 0.5 s at 64^3, and 0.2 s on the CPU.
GPU_PAYS = 100**3


def choose_device(asked: DeviceChoice = "auto", voxels: int | None = None) -> torch.device:
    """Return the device for a setting and the number of voxels of an image.

    ``"auto"`` is the first NVIDIA GPU if it can be used and the image is so large that it is faster
    there (100^3 voxels), else the CPU. ``"mps"``, the GPU of a Mac, forms and compares images, only
    in single precision; transforms of meshes stay on the CPU.

    Raises
    ------
    InputError
        If a GPU is chosen by name and cannot be used; says what is missing and what to do.
    """
    if asked == "cuda" and (reason := missing()):
        raise InputError(f"the GPU cannot be used: {reason}")
    if asked == "mps" and not torch.backends.mps.is_available():
        raise InputError("the device mps cannot be used: it is the GPU of a Mac")
    large = voxels is None or voxels >= GPU_PAYS
    if asked == "cuda" or (asked == "auto" and large and not missing()):
        return torch.device("cuda", torch.cuda.current_device())
    return torch.device(asked if asked == "mps" else "cpu")


def for_objects(device: torch.device) -> torch.device:
    """Return the device on which meshes are transformed for images on another one."""
    return torch.device("cpu") if device.type == "mps" else device


def widest(device: torch.device) -> torch.dtype:
    """Return the most precise real type that a device supports."""
    return torch.float32 if device.type == "mps" else torch.float64
