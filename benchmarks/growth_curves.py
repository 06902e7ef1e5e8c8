"""The paper's two growth curves: time against the size of an image, and against its triangles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import log, sqrt
from typing import TYPE_CHECKING, Any

import torch

from napari_deltamic import GaussianPSF, Grid, Mesh
from napari_deltamic.accuracy.accuracy_chart import short
from napari_deltamic.accuracy.log_chart import PALETTE, Chart, Series, time_text
from napari_deltamic.common.words import duration
from napari_deltamic.fourier import Band
from napari_deltamic.fourier.closed_form import band_ft
from napari_deltamic.geometry import sphere
from napari_deltamic.scene import Renderer, Scene

from . import paper_scheme
from .figure import NARROW, SIGMA, timed, wavevectors

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ACCURACY = 1e-3  # of the particle-mesh
LONGEST = 12.0  # s: what takes longer is reckoned from a part of it
PAPER_SAMPLE = 4_000_000  # pairs that the paper's scheme is timed on
Draw = Callable[[str, Chart], str]  # writes a picture under a name; what shows it on the page


@dataclass(frozen=True)
class Point:
    """Seconds of an image with its gradient, and whether they were reckoned from a part of it."""

    seconds: float
    reckoned: bool = False


def by_size(quick: bool, picture: Draw, facts: dict[str, Any]) -> str:
    """Time against the size of the image, a sphere of 80 triangles."""
    sides = [32, 48, 64] if quick else [32, 48, 64, 100, 128, 160, 200, 256]
    scenes = [(side, sphere(((side - 1) / 2,) * 3, 0.3 * side, subdivisions=1)) for side in sides]
    curves = {name: [way(mesh, side) for side, mesh in scenes] for name, way in WAYS.items()}
    facts["sides"] = sides
    facts["curves"] = _plain(curves)
    title = "80 triangles: time against the size of the image"
    chart = _growth_chart(title, "voxels along each side", sides, curves)
    shown = picture("accuracy_image_size", chart)
    heading = [f"{side}^3" for side in sides]
    return f"{shown}\n\n{_growth_table('voxels', heading, curves)}"


def by_triangles(quick: bool, picture: Draw, facts: dict[str, Any]) -> str:
    """Time against the number of triangles, 100^3 voxels."""
    side = 40 if quick else 100
    meshes = [
        sphere(((side - 1) / 2,) * 3, 0.3 * side, subdivisions=n)
        for n in range(1, 4 if quick else 7)
    ]
    counts = [len(mesh.faces) for mesh in meshes]
    curves = {name: [way(mesh, side) for mesh in meshes] for name, way in WAYS.items()}
    facts["triangles"] = counts
    facts["curves"] = _plain(curves)
    title = f"{side}^3 voxels: time against the number of triangles"
    chart = _growth_chart(title, "triangles", counts, curves)
    shown = picture("accuracy_triangles", chart)
    return f"{shown}\n\n{_growth_table('triangles', [str(c) for c in counts], curves)}"


def _band(side: int, threshold: float) -> Band:
    if threshold == 0:
        return Band.full((side,) * 3, (1.0,) * 3)
    radius = sqrt(2 * log(1 / threshold)) / SIGMA
    return Band.within((side,) * 3, (1.0,) * 3, (radius,) * 3)


def paper(mesh: Mesh, side: int) -> Point:
    """The paper's scheme on the 1 % band, value and gradient, without the FFT."""
    v, f = torch.from_numpy(mesh.vertices_numpy().copy()), torch.as_tensor(mesh.faces)
    v = v - v.mean(0)
    xi = torch.from_numpy(wavevectors(_band(side, NARROW)))
    order = torch.randperm(len(xi), generator=torch.Generator().manual_seed(1))
    count = min(len(xi), max(64, PAPER_SAMPLE // len(f)))
    some = xi[order[:count]]
    chunk = paper_scheme.best_chunk(v, f, some, 0.5)
    grad = torch.randn(count, dtype=torch.complex64, generator=torch.Generator().manual_seed(2))

    def both() -> None:
        paper_scheme.transform(v, f, some, chunk)
        paper_scheme.gradient(v, f, some, grad, chunk)

    seconds = timed(both, 3).wall
    return Point(seconds * len(xi) / count, reckoned=count < len(xi))


def closed(threshold: float) -> Callable[[Mesh, int], Point]:
    """The closed form in single precision on a band (0: the full grid), value and gradient."""

    def way(mesh: Mesh, side: int) -> Point:
        whole = _band(side, threshold)
        v = torch.from_numpy(mesh.vertices_numpy().copy()).requires_grad_()
        f = torch.as_tensor(mesh.faces)
        ones = torch.ones(len(f), dtype=torch.float64)
        # Of every so many rows, where all would take too long.
        share = max(1, round(whole.count * len(f) * 8e-9 / LONGEST))
        rows = whole.rows[::share].contiguous()

        def transform() -> torch.Tensor:
            return band_ft(v, f, ones, rows, whole.spacing, True)

        def both() -> None:
            if share > 1:
                u = transform()
                torch.autograd.grad(u, v, torch.ones_like(u))
                return
            image = whole.to_image(whole.to_box(transform()), (side,) * 3)
            torch.autograd.grad(image, v, torch.ones_like(image))

        part = int(rows[:, 2].sum()) / whole.count
        return Point(timed(both, 1 if share > 1 else 3).wall / part, reckoned=share > 1)

    return way


def particle_mesh(mesh: Mesh, side: int) -> Point:
    """The particle-mesh at the accuracy of the curves, value and gradient."""
    grid, optics = Grid((side,) * 3, (1.0,) * 3), GaussianPSF(SIGMA)
    renderer = Renderer(Scene.of(mesh, optics), grid, ACCURACY, method="particle-mesh")
    v = torch.from_numpy(mesh.vertices_numpy().copy()).requires_grad_()

    def both() -> None:
        image = renderer.image(renderer.transform(v), renderer.otf(optics))
        torch.autograd.grad(image, v, torch.ones_like(image))

    return Point(timed(both, 3).wall)


WAYS: dict[str, Callable[[Mesh, int], Point]] = {
    "paper's scheme, |OTF| > 1 %": paper,
    "closed form, full grid": closed(0.0),
    "closed form, |OTF| > 1 %": closed(NARROW),
    f"particle-mesh, accuracy {short(ACCURACY)}": particle_mesh,
}


_MARKERS = {"triangle": "^", "diamond": "D", "square": "s", "circle": "o"}


@dataclass(frozen=True)
class _GrowthChart(Chart):
    """Times upwards; what was not measured, but reckoned, is drawn as an outline."""

    reckoned: Sequence[Sequence[bool]] = ()  # of each series, of each point

    def figure(self) -> Figure:
        figure = super().figure()
        (axes,) = figure.axes
        axes.yaxis.set_major_formatter(lambda value, _: time_text(value))
        for series, marker, which in zip(
            self.series, _MARKERS.values(), self.reckoned, strict=True
        ):
            points = zip(series.x, series.y, which, strict=True)
            for x, y in ((x, y) for x, y, outline in points if outline):
                axes.plot(
                    x, y, marker, color=PALETTE[series.colour], markersize=8,
                    markerfacecolor="white", markeredgewidth=2,
                )  # fmt: skip
        return figure


def _growth_chart(
    title: str, x_label: str, x: Sequence[int], curves: dict[str, list[Point]]
) -> Chart:
    times = [[p.seconds for p in points] for points in curves.values()]
    series = [
        Series(name, list(x), seconds, colour, marker, line=True)  # type: ignore[arg-type]
        for name, seconds, colour, marker in zip(curves, times, (1, 4, 0, 2), _MARKERS, strict=True)
    ]
    y_label = "time of an image with its gradient"
    reckoned = [[p.reckoned for p in points] for points in curves.values()]
    return _GrowthChart(title, x_label, y_label, series, reckoned=reckoned)


def _growth_table(what: str, heading: Sequence[str], curves: dict[str, list[Point]]) -> str:
    lines = [f"| {what} | " + " | ".join(heading) + " |", "|---|" + "---:|" * len(heading)]
    for name, points in curves.items():
        cells = [duration(p.seconds) + (" *" if p.reckoned else "") for p in points]
        lines.append("| " + " | ".join([name.replace("|", "\\|"), *cells]) + " |")
    return "\n".join([*lines, "", "\\* extrapolated from some of the wavevectors."])


def _plain(curves: dict[str, list[Point]]) -> dict[str, Any]:
    return {name: [[p.seconds, p.reckoned] for p in points] for name, points in curves.items()}
