"""What ``doctor`` says of GPUs, on a machine without one."""

import pytest
import torch

from napari_deltamic.cli import doctor_command
from napari_deltamic.fourier.cuda import device


@pytest.fixture
def one_gpu(monkeypatch):
    """A GPU as far as torch tells; what is missing to use it follows."""
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    monkeypatch.setattr(torch.cuda, "get_device_name", lambda i: "NVIDIA H100")
    monkeypatch.setattr(doctor_command, "choose_device", lambda voxels: torch.device("cpu"))

    def lacks(reason):
        monkeypatch.setattr(doctor_command, "missing", lambda: reason)

    return lacks


def test_a_gpu_that_is_used_is_named_with_its_engines(one_gpu, monkeypatch):
    one_gpu("")
    monkeypatch.setattr(doctor_command.compiler, "version", lambda: (13, 0))
    facts = doctor_command.examine()
    assert (
        facts["devices"]["cuda:0"] == "NVIDIA H100 (used for large images, 100^3 voxels and more)"
    )
    assert "NVRTC 13.0, kept in" in facts["engines"]["closed form on the GPU"]
    assert "NVRTC" in facts["engines"]["particle-mesh on the GPU"]
    assert facts["problems"] == []


def test_what_a_gpu_lacks_is_a_problem_with_its_remedy(one_gpu):
    one_gpu("NVRTC is missing: pip install it")
    facts = doctor_command.examine()
    told = "not used: NVRTC is missing: pip install it"
    assert told in facts["devices"]["cuda:0"]
    assert any(told in problem for problem in facts["problems"])
    assert "closed form on the GPU" not in facts["engines"]


def test_a_torch_for_the_cpu_beside_an_nvidia_gpu_is_a_problem_with_its_remedy(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    monkeypatch.setattr(torch.version, "cuda", None)
    for module in (device, doctor_command):
        monkeypatch.setattr(module, "driver_version", lambda: (12, 8))
    monkeypatch.setattr(doctor_command, "missing", device.missing.__wrapped__)
    facts = doctor_command.examine()
    remedy = "pip install -U torch --index-url https://download.pytorch.org/whl/cu126"
    told = f"not used: this torch is built without CUDA, but there is an NVIDIA GPU: {remedy}"
    assert facts["devices"]["cuda"] == f"an NVIDIA GPU, {told}"
    assert facts["problems"] == [f"there is a GPU, but it is {told}"]


def test_without_a_gpu_there_is_no_problem(monkeypatch):
    monkeypatch.setattr(doctor_command, "driver_version", lambda: None)
    monkeypatch.setattr(doctor_command, "missing", lambda: "no NVIDIA GPU is found")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    facts = doctor_command.examine()
    assert facts["devices"]["cuda"] == "none (no NVIDIA GPU is found)"
    assert facts["problems"] == []
    assert facts["used"]["device"] == "cpu"
