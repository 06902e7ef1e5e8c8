"""What of a fit stays on a GPU: the solver of the preconditioner, and all between two looks."""

import numpy as np
import pytest
import torch

import napari_deltamic as nd
from napari_deltamic.geometry import sphere
from napari_deltamic.inference import factors
from napari_deltamic.inference.preconditioner import Preconditioner
from napari_deltamic.settings import FitSettings

GRID, OPTICS = nd.Grid((40, 40, 40), (0.1, 0.1, 0.1)), nd.GaussianPSF(0.15)
TRUTH, START = (sphere((2.0, 1.9, 2.1), r, subdivisions=3) for r in (1.1, 1.0))


def test_gradients_are_smoothed_as_on_the_cpu(gpu):
    b = np.random.default_rng(0).normal(size=START.vertices.shape)
    there = Preconditioner(START, 10.0, device=gpu).solve(torch.from_numpy(b).to(gpu))
    assert there.device == gpu
    here = Preconditioner(START, 10.0).solve(torch.from_numpy(b))
    torch.testing.assert_close(there.cpu(), here, rtol=0, atol=1e-12)


def test_the_solver_of_the_gpu_runs_on_any_stream(cuda_itself):
    if not factors.driver_is_found():
        pytest.skip("cholespy does not find the driver under the name libcuda.so")
    smoother = Preconditioner(START, 10.0, device=cuda_itself)
    b = torch.randn(len(START.vertices), 3, dtype=torch.float64, device=cuda_itself)
    expected, stream = smoother.solve(b), torch.cuda.Stream()
    stream.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(stream):
        found = smoother.solve(2 * b)
    torch.cuda.current_stream().wait_stream(stream)
    torch.testing.assert_close(found, 2 * expected, rtol=0, atol=1e-9)


def test_nothing_waits_for_the_gpu_between_two_looks(cuda_itself):
    """torch tells of every call that does."""
    if not factors.driver_is_found():
        pytest.skip("gradients are smoothed on the host: cholespy does not find libcuda.so")
    image = nd.render(TRUTH, GRID, OPTICS)
    settings = FitSettings(
        device="cuda",
        accuracy=1e-3,
        levels=(1.0,),
        tolerance=1e-9,
        collisions=False,
        max_iterations=30,
    )
    states = nd.fit(image, GRID, START, OPTICS, settings=settings)
    for _ in range(13):
        next(states)
    torch.cuda.set_sync_debug_mode("error")
    try:
        for _ in range(6):  # 14 to 19
            next(states)
    finally:
        torch.cuda.set_sync_debug_mode("default")
    assert next(states).loss > 0
