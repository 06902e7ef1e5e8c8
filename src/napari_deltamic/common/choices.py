"""What can be chosen by name.

Free of the engine, so that the command line can list it, and refuse the rest, before torch is
loaded.
"""

from os import PathLike
from pathlib import PurePath
from typing import Literal

DeviceChoice = Literal["auto", "cpu", "cuda", "mps"]
DensityModel = Literal["uniform", "interface", "smooth"]
Likelihood = Literal["poisson", "gaussian", "paper"]
# What fluoresces; auto: decided from the image.
Structure = Literal["membrane", "interior", "both"]
StructureChoice = Literal["auto", "membrane", "interior", "both"]

# Relative L2 error of a rendered image where no accuracy is asked for: hardly visible, and below
# the noise of nearly all images.
RENDERED_ACCURACY = 1e-3

Modality = Literal["widefield", "confocal", "spinning disk", "light sheet"]
PSFModel = Literal["gaussian", "scalar", "gibson-lanni", "vectorial", "pupil"]
Bead = Literal["solid", "shell"]
# Refractive indices.
IMMERSIONS = {"air": 1.0, "water": 1.333, "glycerol": 1.45, "silicone": 1.405, "oil": 1.515}

CellKind = Literal["foam", "vesicles"]  # of random cells
Bits = Literal[8, 12, 16, 32]  # of an intensity; 32: float32, which holds any value

# In the order in which they are listed; ``scene.effects.KINDS`` holds the class of each.
EFFECTS = (
    "pixel_integration",
    "background",
    "attenuation",
    "bleaching",
    "illumination",
    "halo",
    "depth_psf",
    "camera",
    "missing",
    "second_view",
)

TIFF = (".tif", ".tiff")
ZARR = ".zarr"  # a folder
IMAGE_FILES = (*TIFF, ".npy", ZARR)


def is_image(path: str | PathLike[str]) -> bool:
    """Whether a path is an image, judged by its name; hidden files are not.

    macOS puts a hidden `._a.tif` beside each `a.tif` on disks of other systems.
    """
    plain = PurePath(path)
    return plain.suffix.lower() in IMAGE_FILES and not plain.name.startswith(".")


AUTO = "auto"  # instead of a file of seeds: cells are looked for in the image


def is_auto(seeds: str) -> bool:
    """Whether seeds are to be found in the image: "auto", "auto:12" (um, size) or "auto@2"."""
    return seeds == AUTO or seeds.startswith((f"{AUTO}:", f"{AUTO}@"))
