"""The operators for GPUs, on tensors of the CPU: emulated kernels, and what happens without any."""

import numpy as np
import pytest
import torch
from cuda_emulation import Emulated

from napari_deltamic.errors import InputError
from napari_deltamic.fourier import closed_form, make_plan
from napari_deltamic.fourier.cost import built_in
from napari_deltamic.fourier.cuda import device, layout, operators, transform
from napari_deltamic.fourier.cuda.build import OutOfMemoryWarning
from napari_deltamic.fourier.cuda.device import NoGpuWarning
from napari_deltamic.fourier.cuda.driver import torch_for
from napari_deltamic.fourier.cuda.layout import contents
from napari_deltamic.fourier.devices import choose_device
from napari_deltamic.geometry import sphere

ROWS = torch.tensor([[-1, 0, 3], [0, 0, 9], [2, -1, 1]], dtype=torch.int32)
SPACING = (0.9, 0.7, 0.5)


def mesh():
    ball = sphere((0.4, -0.2, 0.9), 1.5, subdivisions=1)
    ones = torch.ones(len(ball.faces), dtype=torch.float64)
    return torch.tensor(ball.vertices), torch.as_tensor(ball.faces), ones


def wavevectors():
    return torch.from_numpy(np.random.default_rng(0).normal(size=(13, 3)))


def close(found, expected, bar=1e-5):
    for a, b in zip(found, expected, strict=True):
        assert a.dtype == b.dtype
        assert (a - b).abs().max() <= bar * b.abs().max()


@pytest.fixture(params=["emulated", "missing"])
def without_gpu(request, monkeypatch):
    """What stands in for a GPU: the kernels on the host, or nothing."""
    if request.param == "emulated":
        monkeypatch.setattr(operators, "kernels", lambda device, single: Emulated(single))
        yield
        return
    monkeypatch.setattr(device, "missing", lambda: "a piece is missing: install it")
    device._tell.cache_clear()
    with pytest.warns(NoGpuWarning, match="a piece is missing") as told:
        yield
    assert len(told) == 1  # however many calls
    device._tell.cache_clear()


def test_operators_agree_with_those_of_the_cpu(without_gpu):
    v, f, rho = mesh()
    for single in (True, False):
        band = v, f, rho, ROWS, SPACING, single
        u = closed_form.band_ft(*band)
        close([operators._band_ft_cuda(*band)], [u])
        close(operators._band_ft_backward_cuda(u, *band), closed_form._band_ft_backward(u, *band))
        listed = v, f, rho, wavevectors(), single
        u = closed_form._mesh_ft(*listed)
        close([operators._mesh_ft_cuda(*listed)], [u])
        close(
            operators._mesh_ft_backward_cuda(u, *listed), closed_form._mesh_ft_backward(u, *listed)
        )


def test_operators_are_registered_for_cuda():
    for name in ("mesh_ft", "band_ft"):
        for way in (name, f"{name}_backward"):
            assert torch._C._dispatch_has_kernel_for_dispatch_key(f"deltamic::{way}", "CUDA")


def test_short_memory_halves_the_parts_and_says_so(monkeypatch):
    kernels = Emulated(True, multiprocessors=8)
    v, f, rho = mesh()
    arguments = v, f, rho, ROWS, SPACING
    expected = transform.band_forward(kernels, *arguments)
    refused, empty = [], torch.empty

    def short(size, *args, **kwargs):
        if size == refused_size and len(refused) < 2:
            refused.append(size)
            raise torch.OutOfMemoryError("no more")
        return empty(size, *args, **kwargs)

    parts = dict(kernels.launched)["band_forward"][1]
    refused_size = parts * int(ROWS[:, 2].sum())
    assert parts > 2
    monkeypatch.setattr(torch, "empty", short)
    with pytest.warns(OutOfMemoryWarning, match="fewer, larger pieces"):
        found = transform.band_forward(kernels, *arguments)
    assert refused
    close([found], [expected])


def test_layouts_are_kept_and_follow_changes():
    kernels = Emulated(True)
    v, f, rho = mesh()
    rows = ROWS.clone()
    first = transform.band_forward(kernels, v, f, rho, rows, SPACING)
    rows[1, 0] = 1
    second = transform.band_forward(kernels, v, f, rho, rows, SPACING)
    assert not torch.equal(first, second)
    for other in range(20):
        changed = ROWS.clone()
        changed[0, 0] = other
        transform.band_forward(kernels, v, f, rho, changed, SPACING)
    assert len(layout._layouts) <= 8


# ----------------------------------------------------------------------------------- choices


def test_the_plan_for_a_gpu_is_made_with_its_costs():
    ball = sphere((5.0, 5.0, 5.0), 3.0, subdivisions=4)
    arguments = ball.vertices_numpy(), ball.faces, (100,) * 3, (0.1,) * 3, (0.15,) * 3, 1e-3
    plan = make_plan(*arguments, device="cuda")
    assert plan.device == "cuda"
    there = built_in("cuda").seconds(plan.work, plan.single)
    here = make_plan(*arguments)
    assert there < built_in("cpu").seconds(here.work, here.single)


def test_what_is_asked_for_and_missing_is_an_error_with_the_remedy(monkeypatch):
    module = "napari_deltamic.fourier.devices"
    monkeypatch.setattr(f"{module}.missing", lambda: "NVRTC is missing: pip install it")
    assert choose_device("auto") == choose_device("cpu") == torch.device("cpu")
    with pytest.raises(InputError, match="cannot be used: NVRTC is missing: pip install it"):
        choose_device("cuda")
    monkeypatch.setattr(torch.backends.mps, "is_available", lambda: False)
    with pytest.raises(InputError, match="GPU of a Mac"):
        choose_device("mps")
    monkeypatch.setattr(torch.backends.mps, "is_available", lambda: True)
    assert choose_device("mps").type == "mps"


def test_auto_is_the_gpu_where_nothing_is_missing(monkeypatch):
    monkeypatch.setattr("napari_deltamic.fourier.devices.missing", lambda: "")
    monkeypatch.setattr(torch.cuda, "current_device", lambda: 1)
    assert choose_device("auto") == choose_device("cuda") == torch.device("cuda", 1)


def test_missing_pieces_are_named_one_after_the_other(monkeypatch):
    missing = device.missing.__wrapped__
    monkeypatch.setattr(torch.version, "cuda", None)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    monkeypatch.setattr(device, "driver_version", lambda: None)
    assert missing() == "no NVIDIA GPU is found, or its driver is missing"
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)  # as a torch for AMD says
    assert missing() == "no NVIDIA GPU is found, or its driver is missing"
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    monkeypatch.setattr(device, "driver_version", lambda: (12, 8))
    assert missing() == (
        "this torch is built without CUDA, but there is an NVIDIA GPU: "
        "pip install -U torch --index-url https://download.pytorch.org/whl/cu126"
    )
    monkeypatch.setattr(torch.version, "cuda", "13.0")
    assert missing().startswith("torch for CUDA 13.0 does not run here: pip install -U torch")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "get_device_capability", lambda: (9, 0))
    monkeypatch.setattr(device.compiler, "architecture", lambda capability: "sm_90")
    monkeypatch.setattr(device.compiler, "version", lambda: (13, 5))
    assert missing() == (
        "the driver runs CUDA 12.8, the compiler NVRTC is of 13.5: "
        "pip install 'cuda-bindings==13.*', or update the driver"
    )
    monkeypatch.setattr(device, "driver_version", lambda: (13, 0))
    assert missing() == ""

    def absent(what):
        def raised(*_):
            raise device.CompilerError(what)

        return raised

    for what, remedy in {
        "the Python package cuda-bindings is missing": "pip install 'napari-deltamic[gpu]'",
        "the library NVRTC is missing (not found)": "pip install 'cuda-bindings==13.*'",
        "the sources of the GPU kernels were not installed": "reinstall napari-deltamic",
    }.items():
        monkeypatch.setattr(device.compiler, "architecture", absent(what))
        assert missing() == f"{what}: {remedy}"


@pytest.mark.parametrize(
    ("driver", "expected"),
    [((13, 1), "/cu130"), ((12, 6), "/cu126"), ((11, 8), "update the NVIDIA driver")],
)
def test_the_torch_that_is_advised_runs_on_the_driver(driver, expected):
    assert expected in torch_for(driver)


def test_kernels_that_cannot_be_had_are_asked_for_once(monkeypatch):
    asked = []

    def refused(index, build):
        asked.append(build)
        raise device.CudaError("no more memory")

    monkeypatch.setattr(device, "missing", lambda: "")
    monkeypatch.setattr(device, "DeviceKernels", refused)
    monkeypatch.setattr(device, "_modules", {})
    device._tell.cache_clear()
    with pytest.warns(NoGpuWarning, match="no more memory") as told:
        found = [device.kernels(torch.device("cuda", 0), True) for _ in range(3)]
    assert found == [None] * 3
    assert len(told) == len(asked) == 1
    device._tell.cache_clear()


# ----------------------------------------------------------------------------------- what is kept


def test_tensors_of_inference_mode_are_not_kept():
    kernels = Emulated(True)
    v, f, rho = mesh()
    with torch.inference_mode():
        rows = ROWS.clone()
        first = transform.band_forward(kernels, v, f, rho, rows, SPACING)
        rows[1, 0] = 1
        second = transform.band_forward(kernels, v, f, rho, rows, SPACING)
    assert not torch.equal(first, second)
    assert contents(rows) is None
