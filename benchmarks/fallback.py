"""What is paid where the compiled extension could not be built: ``python -m benchmarks.fallback``.

An image with its gradient, by both methods, of the samples that come with the plugin, on one core,
with the compiled loops and without them. Each side is a process of its own; processor seconds.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

import torch

from napari_deltamic.fourier.plan import METHODS, Method

from .figure import Row
from .page import put_between, table

_HIDDEN = ("napari_deltamic.fourier._mesh_ft", "napari_deltamic.geometry._remesh")
ACCURACY = 1e-2


def seconds_of(function: Callable[[], object], repeats: int) -> float:
    """The least of a few, after one that warms up where it is not the only one."""
    times = []
    for _ in range(repeats):
        began = time.process_time()
        function()
        times.append(time.process_time() - began)
    return min(times)


def measured() -> dict[str, float]:
    """Seconds of every figure, with what this process finds."""
    from napari_deltamic.fourier.native import native
    from napari_deltamic.scene import Renderer, Scene
    from napari_deltamic.scene.samples import Sample, dividing_cell_sample, vesicle_sample

    torch.set_num_threads(1)
    warnings.simplefilter("ignore")

    def rendered(sample: Sample, method: Method) -> Callable[[], object]:
        scene = Scene.of(sample.truth, sample.optics)
        renderer = Renderer(scene, sample.grid, ACCURACY, method=method)

        def once() -> None:
            vertices = torch.tensor(sample.truth.vertices_numpy(), requires_grad=True)
            image = renderer.image(renderer.transform(vertices), renderer.otf(sample.optics))
            image.square().sum().backward()

        return once

    found = {"compiled": float(native() is not None)}
    for sample in (vesicle_sample(), dividing_cell_sample()):
        for method in METHODS:
            repeats = 1 if method == "closed form" else 5
            once = rendered(sample, method)
            found[f"{sample.name}, {method}"] = seconds_of(once, repeats)
    return found


def in_a_process(hidden: Sequence[str]) -> dict[str, float]:
    """The same where some modules cannot be imported."""
    code = (
        f"import sys, json; sys.modules.update(dict.fromkeys({list(hidden)!r})); "
        "from benchmarks.fallback import measured; print(json.dumps(measured()))"
    )
    root = Path(__file__).parents[1]
    done = subprocess.run(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, check=True, cwd=root
    )
    return dict(json.loads(done.stdout.splitlines()[-1]))


def main(argv: Sequence[str]) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.fallback", description=__doc__)
    parser.add_argument("--page", type=Path, metavar="FILE", help="whose figures are replaced")
    chosen = parser.parse_args(argv)
    whole, without = in_a_process(()), in_a_process(_HIDDEN)
    assert whole.pop("compiled"), "the compiled extension is missing"
    assert not without.pop("compiled"), "the compiled extension could not be hidden"
    rows = []
    for name, seconds in whole.items():
        note = f"{1e3 * seconds:.3g} ms compiled, {1e3 * without[name]:.3g} ms without"
        rows.append(Row(name, "", without[name] / seconds, "times", None, note))
    print(table(rows))
    if chosen.page:
        put_between(chosen.page, "fallback", table(rows))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
