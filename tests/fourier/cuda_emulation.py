"""The GPU kernels on the host: compiled by g++ with ``cuda_emulation.h``, launched by the package.

``Emulated`` stands in for a device. ``Extension`` stands in for the compiled extension, with
kernels on the host or on a GPU, so that what tests the loops for CPUs tests those for GPUs too.
"""

import ctypes
import shutil
import subprocess
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from unittest import mock

import pytest
import torch

from napari_deltamic.fourier.cuda import transform
from napari_deltamic.fourier.cuda.build import ClosedFormBuild, PointBuild

HERE = Path(__file__).parent
SOURCES = HERE.parents[1] / "csrc"
# Blocks and tiles so small that a small problem has many, and some that are not full.
SMALL = {
    True: ClosedFormBuild("float", width=8, threads=64, tile=16),
    False: ClosedFormBuild("double", width=4, threads=64, tile=16),
}
SMALL_POINTS = {True: PointBuild("float", 32), False: PointBuild("double", 32)}


@cache
def library(build):
    """The kernels of one type as a shared library."""
    if shutil.which("g++") is None:
        pytest.skip("no g++ here to compile the kernels for the host with")
    out = Path(mkdtemp()) / "kernels.so"
    points = ["-DDELTAMIC_POINTS"] if isinstance(build, PointBuild) else []
    flags = "-std=c++17 -O2 -fno-strict-aliasing -ffp-contract=off -Wall -Wno-unknown-pragmas"
    command = ["g++", *flags.split(), "-shared", "-fPIC", *build.defines, *points]
    command += ["-I", SOURCES, "-include", HERE / "cuda_emulation.h"]
    done = subprocess.run(
        [*command, HERE / "cuda_emulation.cpp", "-o", out], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return ctypes.CDLL(str(out))


class Emulated:
    """Kernels of one type that run on the host."""

    def __init__(self, single, build=None, multiprocessors=1):
        self.build = build or SMALL[single]
        self.multiprocessors = multiprocessors
        self.launched = []
        self._library = library(self.build)

    def launch(self, name, grid, arguments):
        self.launched.append((name, grid))
        places = (ctypes.c_void_p * len(arguments))(*(ctypes.addressof(a) for a in arguments))
        failed = self._library.launch(name.encode(), *map(ctypes.c_uint, grid), places)
        assert failed == 0, f"{name} on a grid of {grid} came to a halt"


class Extension:
    """The functions of the compiled extension, done by kernels on a device."""

    def __init__(self, kernels_of, device="cpu"):
        for single, name in ((True, "f32"), (False, "f64")):
            kernels = kernels_of(single)
            for loop in ("band", "list"):
                forward, backward = self._functions(kernels, loop, device)
                setattr(self, f"{loop}_forward_{name}", forward)
                setattr(self, f"{loop}_backward_{name}", backward)

    @staticmethod
    def _functions(kernels, loop, device):
        def split(arguments):
            """Mesh and wavevectors as tensors; what is left of the arguments."""
            count = 6 if loop == "band" else 4
            mesh = [torch.from_numpy(a).to(device) for a in arguments[:3]]
            where = [torch.from_numpy(arguments[3]).to("cpu" if loop == "band" else device)]
            if loop == "band":
                where.append(arguments[5])
            return mesh, where, arguments[count:]

        def forward(*arguments):
            mesh, where, (out, *_) = split(arguments)
            u = getattr(transform, f"{loop}_forward")(kernels, *mesh, *where)
            out[...] = torch.view_as_real(u).cpu().numpy()

        def backward(*arguments):
            mesh, where, (grad, by_vertex, by_density, *_) = split(arguments)
            incoming = torch.view_as_complex(torch.from_numpy(grad)).to(device)
            found = getattr(transform, f"{loop}_backward")(kernels, incoming, *mesh, *where)
            by_vertex[...], by_density[...] = (t.cpu().numpy() for t in found)

        return forward, backward


@cache
def emulated(multiprocessors):
    """The extension with kernels on the host."""
    return Extension(lambda single: Emulated(single, multiprocessors=multiprocessors))


@contextmanager
def engine(multiprocessors=1, extension=None):
    """Run everything that the compiled extension does in an extension of kernels."""
    found = extension or emulated(multiprocessors)
    with mock.patch("napari_deltamic.fourier.closed_form.native", return_value=found):
        yield
