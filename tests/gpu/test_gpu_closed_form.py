"""The kernels on a GPU: against the loops for CPUs and 50-digit arithmetic, and as torch's own."""

import threading
import warnings

import numpy as np
import pytest
import torch
import triangle_errors as errors
from cuda_emulation import Extension, engine
from triangle_families import NO_AREA, families

import napari_deltamic as nd
from napari_deltamic.fourier import Band
from napari_deltamic.fourier.closed_form import band_ft
from napari_deltamic.fourier.cuda import compiler
from napari_deltamic.fourier.cuda.build import CLOSED_FORM, OutOfMemoryWarning
from napari_deltamic.fourier.cuda.device import DeviceKernels, kernels
from napari_deltamic.geometry import sphere

BAND = Band.within((40, 48, 36), (0.15, 0.125, 0.15), (12.0, 16.0, 14.0))
BAR = {True: 1e-5, False: 1e-12}
TYPES = pytest.mark.parametrize("single", [True, False])


def ball(device, subdivisions=3):
    mesh = sphere((0.4, -0.2, 0.9), 1.5, subdivisions=subdivisions)
    rho = torch.linspace(0.5, 2, len(mesh.faces), dtype=torch.float64)
    return tuple(
        t.to(device) for t in (torch.tensor(mesh.vertices), torch.as_tensor(mesh.faces), rho)
    )


def wavevectors(count, device):
    return 3 * torch.from_numpy(np.random.default_rng(0).normal(size=(count, 3))).to(device)


def on_band(mesh, single, band=BAND):
    """u_hat and gradients of a weighted sum, on the device of the mesh."""
    v, f, rho = mesh
    v, rho = v.clone().requires_grad_(), rho.clone().requires_grad_()
    u = band_ft(v, f, rho, band.rows, band.spacing, single)
    weight = torch.linspace(-1, 1, len(u), device=u.device, dtype=u.real.dtype)
    loss = ((u.real - u.imag) * weight).sum()
    return [t.detach() for t in (u, *torch.autograd.grad(loss, (v, rho)))]


def close(found, expected, bar):
    for a, b in zip(found, expected, strict=True):
        assert a.dtype == b.dtype
        scale = float(b.abs().max()) if b.numel() else 0.0
        torch.testing.assert_close(a.cpu(), b.cpu(), rtol=0, atol=bar * scale)


@TYPES
@pytest.mark.parametrize("loop", ["list", "band"])
def test_adversarial_triangles(gpu, loop, single):
    extension = Extension(lambda single: kernels(gpu, single), gpu)
    bar = errors.BAR["float32" if single else "float64"]
    worst = {}
    with engine(extension=extension):
        for name, (v, xi) in families().items():
            for quantity, error in errors.measured_errors(loop, v, xi, single).items():
                worst[name, quantity] = error
    assert max(worst.values()) <= bar, max(worst.items(), key=lambda item: item[1])


@TYPES
@pytest.mark.parametrize("faces", [0, 1, 63, 64, 65, None])
def test_bands_are_those_of_the_cpu(gpu, single, faces):
    v, f, rho = ball("cpu")
    mesh = v, f[:faces], rho[:faces]
    found, expected = on_band(tuple(t.to(gpu) for t in mesh), single), on_band(mesh, single)
    assert all(t.device == gpu for t in found)
    close(found, expected, BAR[single])


@TYPES
@pytest.mark.parametrize("count", [1, 127, 129, 3000])
def test_lists_are_those_of_the_cpu(gpu, single, count):
    results = []
    for device in ("cpu", gpu):
        v, f, rho = ball(device, 2)
        v = v.to(torch.float32 if single else torch.float64).requires_grad_()
        u = nd.fourier.mesh_ft(v, f, wavevectors(count, device), rho)
        (g,) = torch.autograd.grad(u.abs().square().sum(), v)
        results.append((u.detach(), g))
    close(*reversed(results), BAR[single])


@TYPES
def test_faces_without_area_give_exactly_zero(gpu, single):
    corners = np.array([v * 3 if len(v) == 1 else v for v in NO_AREA.values()], float)
    faces = torch.arange(3 * len(corners)).reshape(-1, 3)
    mesh = (
        torch.tensor(corners).reshape(-1, 3),
        faces,
        torch.ones(len(corners), dtype=torch.float64),
    )
    for t in on_band(tuple(t.to(gpu) for t in mesh), single):
        assert not t.any()


def test_a_whole_mesh_in_single_precision_has_the_gradient_of_double(gpu):
    ours, exact = (on_band(ball(gpu), single)[1] for single in (True, False))
    assert (ours - exact).norm() < 1e-5 * exact.norm()


# -------------------------------------------------------------------------------- as torch's own


@TYPES
def test_same_bits_again_and_on_another_stream_and_thread(cuda_itself, single):
    mesh = ball(cuda_itself)
    first = on_band(mesh, single)
    stream, by_thread = torch.cuda.Stream(), []
    stream.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(stream):
        aside = on_band(mesh, single)
    stream.synchronize()
    thread = threading.Thread(target=lambda: by_thread.extend(on_band(mesh, single)))
    thread.start()
    thread.join()
    for other in (on_band(mesh, single), aside, by_thread):
        assert all(map(torch.equal, first, other))


def test_gradcheck(gpu):
    v, f, rho = ball(gpu, 0)
    v, rho = v.requires_grad_(), rho.requires_grad_()
    rows, xi = torch.tensor([[-1, 0, 3], [2, -1, 9]], dtype=torch.int32), wavevectors(5, gpu)
    assert torch.autograd.gradcheck(
        lambda v, rho: band_ft(v, f, rho, rows, (0.9, 0.7, 0.5), False), (v, rho)
    )
    assert torch.autograd.gradcheck(lambda v, rho: nd.fourier.mesh_ft(v, f, xi, rho), (v, rho))


def test_compiled_functions_agree(gpu):
    v, f, rho = ball(gpu, 1)

    def function(v):
        return band_ft(v, f, rho, BAND.rows, BAND.spacing, False).abs().square().sum()

    given = v.clone().requires_grad_()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # torch talks about what it cannot trace
        compiled = torch.compile(function, backend="aot_eager")(given)
        (by_compiled,) = torch.autograd.grad(compiled, given)
    (by_plain,) = torch.autograd.grad(function(given), given)
    close([compiled.detach(), by_compiled], [function(v), by_plain], 1e-12)


def test_operators_are_registered_correctly(gpu):
    v, f, rho = (t.requires_grad_(t.is_floating_point()) for t in ball(gpu, 0))
    rows = torch.tensor([[-1, 0, 3], [2, -1, 9]], dtype=torch.int32)
    for single in (False, True):
        torch.library.opcheck(torch.ops.deltamic.mesh_ft, (v, f, rho, wavevectors(5, gpu), single))
        band = v, f, rho, rows, [0.9, 0.7, 0.5], single
        torch.library.opcheck(torch.ops.deltamic.band_ft, band)


def test_short_memory_takes_fewer_pieces_and_says_so(cuda_itself):
    """A limit that leaves room for the result and a few parts of it."""
    mesh, band = ball(cuda_itself, 4), Band.full((240, 240, 240), (0.1, 0.1, 0.1))
    u = band_ft(*mesh, band.rows, band.spacing, True)  # segments stay, the result goes
    expected, size = u[::1000].clone(), 8 * len(u)
    del u
    torch.cuda.empty_cache()
    total = torch.cuda.get_device_properties(cuda_itself).total_memory
    torch.cuda.set_per_process_memory_fraction(
        (torch.cuda.memory_reserved() + 2.5 * size) / total, cuda_itself
    )
    try:
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            found = band_ft(*mesh, band.rows, band.spacing, True)[::1000].clone()
    finally:
        torch.cuda.set_per_process_memory_fraction(1.0, cuda_itself)
    close([found], [expected], 1e-6)
    assert all(issubclass(w.category, OutOfMemoryWarning) for w in told)


def test_kernels_come_from_disk_the_second_time(cuda_itself, tmp_path, monkeypatch):
    monkeypatch.setenv("DELTAMIC_CACHE", str(tmp_path))
    DeviceKernels(cuda_itself.index, CLOSED_FORM[True])
    monkeypatch.setattr(compiler, "compile_kernels", None)
    assert DeviceKernels(cuda_itself.index, CLOSED_FORM[True]).multiprocessors > 0
