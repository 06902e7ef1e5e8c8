"""Compiled kernels on a device, or the reason why there are none."""

from __future__ import annotations

import ctypes
import threading
import warnings
from collections.abc import Sequence
from functools import cache
from typing import Any

import torch

from . import compiler
from .compiler import CompilerError
from .transform import DOUBLE, SINGLE, Build

# What to type where something is missing.
INSTALL_TORCH = "pip install -U torch --index-url https://download.pytorch.org/whl/cu130"
INSTALL_BINDINGS = "pip install 'napari-deltamic[gpu]'"


class NoGpuWarning(UserWarning):
    """There is a GPU, but something is missing to use it; everything runs on the CPU."""


@cache
def missing() -> str:
    """What keeps the GPU from being used, in one sentence with the remedy; empty if nothing."""
    if torch.version.cuda is None:
        return f"this torch is built without CUDA; for an NVIDIA GPU: {INSTALL_TORCH}"
    if not torch.cuda.is_available():
        return "no NVIDIA GPU is found, or its driver is missing"
    try:
        compiler.source_folder()
        compiler.architecture(torch.cuda.get_device_capability())
    except CompilerError as error:
        remedy = "reinstall napari-deltamic" if "sources" in str(error) else INSTALL_BINDINGS
        return f"{error}: {remedy}"
    return ""


@cache
def _tell(reason: str) -> None:
    warnings.warn(
        f"the closed form runs on the CPU, not on the GPU: {reason}", NoGpuWarning, stacklevel=4
    )


def kernels(device: torch.device, single: bool) -> DeviceKernels | None:
    """The kernels of a type on a CUDA device; None (after one warning) where they cannot be had."""
    reason = missing()
    if not reason:
        index = device.index if device.index is not None else torch.cuda.current_device()
        try:
            return _loaded(index, single)
        except (CompilerError, CudaError) as error:
            reason = str(error)
    _tell(reason)
    return None


_lock = threading.Lock()
_modules: dict[tuple[int, bool], DeviceKernels] = {}


def _loaded(index: int, single: bool) -> DeviceKernels:
    with _lock:  # two threads would compile the same
        if (index, single) not in _modules:
            _modules[index, single] = DeviceKernels(index, SINGLE if single else DOUBLE)
        return _modules[index, single]


class CudaError(RuntimeError):
    """The driver refused a call."""


class DeviceKernels:
    """The kernels of one type, loaded into the context that torch uses of a device.

    Raises
    ------
    CompilerError
        If they cannot be compiled for this device.
    CudaError
        If the driver does not take them.
    """

    def __init__(self, index: int, build: Build) -> None:
        from cuda.bindings import driver

        self._driver = driver
        self._index = index
        self.build = build
        properties = torch.cuda.get_device_properties(index)
        self.multiprocessors = int(properties.multi_processor_count)
        target = compiler.architecture((properties.major, properties.minor))
        code = compiler.kernels_for(build, target)
        self._context = self._call(driver.cuDevicePrimaryCtxRetain, self._device())
        with self:
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
        shape = (*grid, 1, self.build.threads, 1, 1)
        with self:
            self._call(
                self._driver.cuLaunchKernel,
                self._function(name),
                *shape,
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
