"""What is paid where the compiled extension, or cholespy, is missing, on this machine.

    python -m benchmarks.fallback

Each column is measured in a process of its own: the closed form of a mesh on a band, the fit of the
demonstration, and the smoothing of gradients on a mesh of 10,000 vertices. CPU seconds.
"""

from __future__ import annotations

import json
import subprocess
import sys

_HIDE = "import sys; sys.modules.update({m: None for m in %r}); "
_MISSING = {
    "the extension": ("napari_deltamic.fourier._mesh_ft", "napari_deltamic.geometry._remesh"),
    "cholespy": ("cholespy",),
}
_CODE = """
import json, time, warnings
warnings.simplefilter("ignore")
import numpy as np, torch
import napari_deltamic as nd
from napari_deltamic.cli import demonstration as demo
from napari_deltamic.scene.samples import dividing_cell_sample
from napari_deltamic.geometry import sphere
from napari_deltamic.fitting.preconditioner import Preconditioner

mesh = sphere((0, 0, 0), 3.0, subdivisions=3)
xi = torch.from_numpy(np.random.default_rng(0).normal(0, 3, (2_000, 3)))
times = []
for _ in range(3):
    began = time.process_time()
    nd.fourier.mesh_ft(mesh.vertices, mesh.faces, xi)
    times.append(time.process_time() - began)
sample = dividing_cell_sample()
settings = demo.demo_settings(sample, demo.Path("."))
began, iterations = time.process_time(), 0
psf = nd.GaussianPSF(settings.scene.sigma)
for state in nd.fit(sample.image, sample.grid, demo.start_mesh(sample), psf, settings=settings.fit):
    iterations = state.iteration
took = time.process_time() - began
fine = sphere((0, 0, 0), 3.0, subdivisions=5)
began = time.process_time()
smooth = Preconditioner(fine, 20.0)
factored = time.process_time() - began
b = torch.ones((len(fine.vertices), 3), dtype=torch.float64)
began = time.process_time()
for _ in range(20):
    smooth.solve(b)
solved = (time.process_time() - began) / 20
print(json.dumps({
    "closed form": min(times), "fit": took, "iteration": took / iterations,
    "factorisation": factored, "smoothing": solved,
}))
"""


def measured(code: str) -> dict[str, float]:
    """CPU seconds of each row, in a process of its own."""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return dict(json.loads(done.stdout.splitlines()[-1]))


def main() -> None:
    """Print the table."""
    from napari_deltamic.accuracy.machine_costs import processor
    from napari_deltamic.fourier.native import threads

    print(f"{processor()}, {threads()} threads")
    whole = measured(_CODE)
    for what, parts in _MISSING.items():
        without = measured(_HIDE % (parts,) + _CODE)
        for name, seconds in whole.items():
            ratio = without[name] / seconds
            print(f"{name}: {seconds:.3g} s, without {what} {without[name]:.3g} s ({ratio:.2g} x)")


if __name__ == "__main__":
    main()
