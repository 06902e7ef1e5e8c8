"""Loads compiled kernels on a device, or says why it cannot."""

from __future__ import annotations

import ctypes
import threading
import warnings
from collections.abc import Sequence
from functools import cache
from typing import Any, Generic, TypeVar

import torch

from . import compiler
from .build import CLOSED_FORM, POINTS, Build, ClosedFormBuild, Of, PointBuild
from .compiler import CompilerError
from .driver import driver_version, torch_for

Made = TypeVar("Made", bound=Build)
INSTALL_BINDINGS = "pip install 'napari-deltamic[gpu]'"


class NoGpuWarning(UserWarning):
    """There is a GPU, but something is missing to use it as it could be."""


@cache
def missing() -> str:
    """Say in one sentence what keeps the GPU from being used, with the remedy; "" if nothing."""
    driver = driver_version()
    # Builds of torch for AMD GPUs say that CUDA is available, too.
    if driver is None and (torch.version.cuda is None or not torch.cuda.is_available()):
        return "no NVIDIA GPU is found, or its driver is missing"
    if torch.version.cuda is None:
        assert driver is not None
        return f"this torch is built without CUDA, but there is an NVIDIA GPU: {torch_for(driver)}"
    if not torch.cuda.is_available():
        assert driver is not None
        return f"torch for CUDA {torch.version.cuda} does not run here: {torch_for(driver)}"
    own = f"pip install 'cuda-bindings=={torch.version.cuda.split('.')[0]}.*'"
    try:
        compiler.source_folder()
        compiler.architecture(torch.cuda.get_device_capability())
    except CompilerError as error:
        remedy = INSTALL_BINDINGS
        if "sources" in str(error):
            remedy = "reinstall napari-deltamic"
        elif "library" in str(error):  # the bindings are for another CUDA than torch's
            remedy = own
        return f"{error}: {remedy}"
    # The driver does not load what the compiler of a newer CUDA makes.
    major, minor = compiler.version()
    if driver is not None and major > driver[0]:
        runs = f"the driver runs CUDA {driver[0]}.{driver[1]}"
        return f"{runs}, the compiler NVRTC is of {major}.{minor}: {own}, or update the driver"
    return ""


@cache
def _tell(what: str, reason: str) -> None:
    warnings.warn(f"{what}: {reason}", NoGpuWarning, stacklevel=4)


def kernels(device: torch.device, single: bool) -> DeviceKernels[ClosedFormBuild] | None:
    """Return the closed form's kernels on a CUDA device; None, after one warning, if impossible."""
    what = "the closed form runs on the CPU, not on the GPU"
    return _loaded(device, CLOSED_FORM[single], what)


def point_kernels(device: torch.device, single: bool) -> DeviceKernels[PointBuild] | None:
    """Return kernels for spreading and gathering; None, after one warning, if impossible."""
    return _loaded(device, POINTS[single], "the GPU computes several times slower than it could")


def _loaded(device: torch.device, build: Made, otherwise: str) -> DeviceKernels[Made] | None:
    reason = missing()
    if not reason:
        index = device.index if device.index is not None else torch.cuda.current_device()
        found = _kept(index, build)
        if not isinstance(found, str):
            return found
        reason = found
    _tell(otherwise, reason)
    return None


_lock = threading.Lock()
_modules: dict[tuple[int, Any], Any] = {}


def _kept(index: int, build: Made) -> DeviceKernels[Made] | str:
    """Return kernels, or why there are none; tried only once, since compiling takes seconds."""
    with _lock:  # two threads would compile the same
        if (index, build) not in _modules:
            try:
                _modules[index, build] = DeviceKernels(index, build)
            except (CompilerError, CudaError) as error:
                _modules[index, build] = str(error)
        found: DeviceKernels[Made] | str = _modules[index, build]
        return found


class CudaError(RuntimeError):
    """The driver refused a call."""


class DeviceKernels(Generic[Of]):
    """The kernels of one build, loaded into the context that torch uses on a device.

    Raises
    ------
    CompilerError
        If they cannot be compiled for this device.
    CudaError
        If the driver cannot load them.
    """

    def __init__(self, index: int, build: Of) -> None:
        from cuda.bindings import driver

        self._driver = driver
        self._index = index
        self.build = build
        properties = torch.cuda.get_device_properties(index)
        self.multiprocessors = int(properties.multi_processor_count)
        target = compiler.architecture((properties.major, properties.minor))
        self._context = self._call(driver.cuDevicePrimaryCtxRetain, self._device())
        with self:
            try:
                code = compiler.kernels_for(build, target)
                self._module = self._call(driver.cuModuleLoadData, code)
            except CudaError:  # a file that was damaged on disk
                code = compiler.kernels_for(build, target, anew=True)
                self._module = self._call(driver.cuModuleLoadData, code)
        self._functions: dict[str, Any] = {}

    def _device(self) -> Any:
        self._call(self._driver.cuInit, 0)
        return self._call(self._driver.cuDeviceGet, self._index)

    def __enter__(self) -> None:
        # A thread that has used nothing but torch's memory cache may have no context yet.
        self._call(self._driver.cuCtxPushCurrent, self._context)

    def __exit__(self, *_: object) -> None:
        self._call(self._driver.cuCtxPopCurrent)

    def _function(self, name: str) -> Any:
        if name not in self._functions:
            get = self._driver.cuModuleGetFunction
            self._functions[name] = self._call(get, self._module, name.encode())
        return self._functions[name]

    def launch(self, name: str, grid: tuple[int, int], arguments: Sequence[Any]) -> None:
        """Start a kernel on torch's current stream of the device."""
        places = (ctypes.c_void_p * len(arguments))(*(ctypes.addressof(a) for a in arguments))
        stream = torch.cuda.current_stream(self._index).cuda_stream
        with self:
            self._call(
                self._driver.cuLaunchKernel,
                self._function(name),
                *grid,
                1,
                self.build.threads,
                1,
                1,
                0,
                stream,
                ctypes.addressof(places),
                0,
            )

    def _call(self, function: Any, *arguments: Any) -> Any:
        status, *result = function(*arguments)
        if int(status):
            _, text = self._driver.cuGetErrorString(status)
            raise CudaError(f"{function.__name__}: {(text or b'unknown').decode()}")
        return result[0] if result else None
