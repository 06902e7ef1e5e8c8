"""The solver of the preconditioner on a GPU."""

import numpy as np
import pytest
import torch

from napari_deltamic.fitting import factors
from napari_deltamic.fitting.preconditioner import Preconditioner
from napari_deltamic.geometry import sphere

START = sphere((2.0, 1.9, 2.1), 1.0, subdivisions=3)


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
