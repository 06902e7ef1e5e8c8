"""How kernels are loaded and launched, by a driver that runs them on the host."""

import ctypes
import sys
from types import SimpleNamespace

import pytest
import torch
from cuda_emulation import SMALL, Emulated, library

from napari_deltamic.fourier.cuda import compiler, transform
from napari_deltamic.fourier.cuda.device import CudaError, DeviceKernels

bindings = pytest.importorskip("cuda.bindings")
STREAM = 77
ROWS = torch.tensor([[-1, 0, 3], [0, 0, 9], [2, -1, 1]], dtype=torch.int32)
SPACING = (0.9, 0.7, 0.5)


class Driver:
    """The part of ``cuda.bindings.driver`` that is used: (status, results) of each call."""

    def __init__(self, build):
        self._library = library(build)
        self.contexts = []  # of the thread, the current one last
        self.streams, self.refuses = set(), set()

    def cuInit(self, flags):
        return (0,)

    def cuDeviceGet(self, index):
        return 0, f"device {index}"

    def cuDevicePrimaryCtxRetain(self, device):
        return 0, f"context of {device}"

    def cuCtxPushCurrent(self, context):
        self.contexts.append(context)
        return (0,)

    def cuCtxPopCurrent(self):
        return 0, self.contexts.pop()

    def cuModuleLoadData(self, code):
        assert self.contexts == ["context of device 3"]
        return (200, None) if code in self.refuses else (0, code)

    def cuModuleGetFunction(self, module, name):
        return 0, name

    def cuLaunchKernel(self, name, x, y, z, threads, ty, tz, shared, stream, arguments, extra):
        assert self.contexts == ["context of device 3"]
        assert (z, ty, tz, shared, extra) == (1, 1, 1, 0, 0)
        assert threads == SMALL[True].threads
        self.streams.add(stream)
        # As the driver does: the array holds the address of each argument.
        return (self._library.launch(name, x, y, ctypes.c_void_p(arguments)),)

    def cuGetErrorString(self, status):
        return 0, b"the device kernel image is invalid"


@pytest.fixture
def driver(monkeypatch):
    """A GPU with the number 3 and four multiprocessors."""
    fake = Driver(SMALL[True])
    monkeypatch.setitem(sys.modules, "cuda.bindings.driver", fake)
    monkeypatch.setattr(bindings, "driver", fake, raising=False)
    facts = SimpleNamespace(multi_processor_count=4, major=9, minor=0)
    monkeypatch.setattr(torch.cuda, "get_device_properties", lambda index: facts)
    monkeypatch.setattr(
        torch.cuda, "current_stream", lambda index: SimpleNamespace(cuda_stream=STREAM)
    )
    monkeypatch.setattr(compiler, "architecture", lambda capability: "sm_90")
    monkeypatch.setattr(
        compiler, "kernels_for", lambda build, target, anew=False: b"new" if anew else b"kept"
    )
    return fake


def test_launches_run_in_the_context_and_on_the_stream_of_torch(driver):
    kernels = DeviceKernels(3, SMALL[True])
    generator = torch.Generator().manual_seed(0)
    mesh = torch.randn(6, 3, dtype=torch.float64, generator=generator), torch.arange(6).view(2, 3)
    arguments = *mesh, torch.ones(2, dtype=torch.float64), ROWS, SPACING
    found = transform.band_forward(kernels, *arguments)
    assert torch.equal(found, transform.band_forward(Emulated(True, multiprocessors=4), *arguments))
    gradients = transform.band_backward(kernels, found, *arguments)
    assert all(t.isfinite().all() for t in gradients)
    assert driver.streams == {STREAM}
    assert driver.contexts == []  # none is left behind


def test_a_file_that_the_driver_refuses_is_compiled_anew(driver):
    driver.refuses.add(b"kept")
    assert DeviceKernels(3, SMALL[True])._module == b"new"


def test_what_the_driver_says_is_told(driver):
    driver.refuses |= {b"kept", b"new"}
    with pytest.raises(CudaError, match="cuModuleLoadData: the device kernel image is invalid"):
        DeviceKernels(3, SMALL[True])
    assert driver.contexts == []
