"""Figures of a rendering with its gradient: time, error, growth, memory."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from napari_deltamic import Mesh, render
from napari_deltamic.optics import Optics
from napari_deltamic.scene import Renderer, Scene

from .figure import (
    Figure,
    Options,
    Row,
    at_most,
    cow,
    scene,
    slope,
    sphere_of,
    tensors,
    timed,
    timed_together,
)


def render_and_gradient(options: Options) -> list[Row]:
    """An image at accuracy 1e-3 with its gradient: time and measured error."""
    accuracy, mesh = 1e-3, cow(options)
    (grid, optics), target = scene(), torch.randn(100, 100, 100)
    renderer = Renderer(Scene.of(mesh, optics), grid, accuracy)
    v = tensors(mesh)[0].requires_grad_()

    def forward() -> Tensor:
        return renderer.image(renderer.transform(v), renderer.otf(optics))

    def both() -> Tensor:
        return torch.autograd.grad(forward(), v, target)[0]

    def once() -> Tensor:
        image = render(Mesh(v, mesh.faces), grid, optics, accuracy)
        return torch.autograd.grad(image, v, target)[0]

    whole, again, image = timed_together([once, both, forward], 3 * options.repeats)
    exact, how = (
        render(Mesh(v, mesh.faces), grid, optics, 1e-8, method="particle-mesh"),
        "itself, 1e-8",
    )
    slow = torch.autograd.grad(exact, v, target.to(exact.dtype))[0]
    if not options.quick:
        exact, how = render(mesh, grid, optics, 1e-5, method="closed form"), "the closed form, 1e-5"
    error = float(((forward() - exact).norm() / exact.norm()).detach())
    slip = float((both() - slow).norm() / slow.norm())
    plan = renderer.plan
    note = f"{plan.method}, {plan.points} points, box {'x'.join(map(str, plan.band.box_shape))}"
    note, what = f"{note}; against {how}", "cow, 100^3, 1e-3"
    return [
        at_most(f"render + gradient, {what}", 60, 1e3 * whole.wall, "ms", whole.note()),
        at_most(f"the same, plan made, {what}", 60, 1e3 * again.wall, "ms", again.note()),
        Row(f"render, plan made, {what}", "", 1e3 * image.wall, "ms", None, image.note()),
        at_most(f"error of the image, {what}", accuracy, error, "relative", note),
        Row(f"error of the gradient, {what}", "", slip, "relative", None, "against white noise"),
    ]


# ------------------------------------------------------------------------------------ growth


def growth(options: Options) -> list[Row]:
    """Exponents: time over faces, time over voxels."""
    rows = []
    counts = [5_000 * 2**i for i in (range(0, 5, 2) if options.quick else range(6))]
    for method, voxels in (("closed form", 48), ("particle-mesh", 64)):
        faces, timings = [], []
        for count in counts:
            mesh = sphere_of(count, voxels, 0.3 * voxels)
            grid, optics = scene(voxels)
            renderer = Renderer(Scene.of(mesh, optics), grid, 1e-2, method=method)
            v = tensors(mesh)[0].requires_grad_()
            timings.append(timed(_one_rendering(renderer, v, optics), 3))
            faces.append(len(mesh.faces))
        wall, cpu = (slope(faces, [getattr(t, k) for t in timings]) for k in ("wall", "cpu"))
        range_ = f"{faces[0]} to {faces[-1]} faces at {voxels}^3, 1e-2"
        ends = f"{1e3 * timings[0].wall:.3g} to {1e3 * timings[-1].wall:.3g} ms; CPU time {cpu:.2f}"
        figure, note = f"growth with faces, {method}", f"{range_}, {ends}"
        rows.append(at_most(figure, 1.1, wall, "exponent", note))
    sides = [64, 96, 128] if options.quick else [64, 96, 128, 192, 256]
    timings, work = [], []
    for side in sides:
        mesh = sphere_of(5_000, side, 20.0)
        grid, optics = scene(side)
        renderer = Renderer(Scene.of(mesh, optics), grid, 1e-3, method="particle-mesh")
        v = tensors(mesh)[0].requires_grad_()
        timings.append(timed(_one_rendering(renderer, v, optics), 3))
        work.append(side**3 * np.log2(side**3))
    wall, cpu = (slope(work, [getattr(t, k) for t in timings]) for k in ("wall", "cpu"))
    each = ", ".join(f"{n}^3: {1e3 * t.wall:.3g} ms" for n, t in zip(sides, timings, strict=True))
    note = f"{each}; CPU time {cpu:.2f}"
    rows.append(at_most("growth with voxels N, over N log N", 1.1, wall, "exponent", note))
    return rows


def _one_rendering(renderer: Renderer, v: Tensor, optics: Optics) -> Callable[[], object]:
    def both() -> None:
        image = renderer.image(renderer.transform(v), renderer.otf(optics))
        torch.autograd.grad(image, v, image.detach())

    return both


# ------------------------------------------------------------------------------------ memory

_LARGE = """
import json, resource, sys, time
import torch
from benchmarks.figure import scene, sphere_of
from napari_deltamic import Mesh, render
side, faces = int(sys.argv[1]), int(sys.argv[2])
mesh = sphere_of(faces, side, 0.4 * side)
v = torch.from_numpy(mesh.vertices_numpy()).requires_grad_()
grid, optics = scene(side)
start = time.perf_counter(), time.process_time()
image = render(Mesh(v, mesh.faces), grid, optics, 1e-3)
middle = time.perf_counter()
torch.autograd.grad(image, v, image.detach())
stop = time.perf_counter(), time.process_time()
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
peak *= 1 if sys.platform == "darwin" else 1024
print(json.dumps({"faces": len(mesh.faces), "peak": peak, "forward": middle - start[0],
                  "wall": stop[0] - start[0], "cpu": stop[1] - start[1]}))
"""


def memory(options: Options) -> list[Row]:
    """Peak memory of a large image with its gradient, measured in a process of its own."""
    side = 200 if options.quick else 500
    done = subprocess.run(
        [sys.executable, "-c", _LARGE, str(side), "20000"],
        capture_output=True,
        text=True,
        cwd=Path(__file__).resolve().parents[1],
    )
    figure = f"peak memory, {side}^3 voxels, render + gradient, 1e-3"
    if done.returncode != 0:
        last = (done.stderr.strip().splitlines() or [""])[-1]
        return [Row(figure, "<= 12", float("nan"), "GB", False, f"exit {done.returncode}: {last}")]
    r = json.loads(done.stdout.splitlines()[-1])
    note = f"{r['faces']} faces; forward {r['forward']:.1f} s, CPU {r['cpu']:.1f} s"
    return [
        at_most(figure, 12, r["peak"] / 1e9, "GB", note),
        Row(f"its time, {side}^3 voxels", "", r["wall"], "s", None, note),
    ]


FIGURES: dict[str, Figure] = {
    "render-and-gradient": render_and_gradient,
    "growth": growth,
    "memory": memory,
}
