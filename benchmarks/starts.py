"""How far off a fit may start and how noisy its image may be: ``python -m benchmarks.starts``.

The experiments of the paper's section on robustness, on its targets: a sphere that starts too small
or too large, a sphere that starts beside the target, an image with noise. Each is fitted coarse to
fine, and by gradient descent at one scale with the paper's loss and preconditioner. Writes a table
and a picture into ``docs/stability.md``.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median

import numpy as np
from numpy.typing import NDArray

from napari_deltamic import Change, FitState, GaussianPSF, Grid, Mesh, fit, render
from napari_deltamic.geometry import sphere
from napari_deltamic.measure import surface_distance
from napari_deltamic.runs.settings import FitSettings

from .figure import default_data_folder, target
from .page import put_between

PAGE = Path(__file__).resolve().parents[1] / "docs" / "stability.md"
PICTURE = "images/robustness.png"
TARGETS = ("cow", "fish")
GRID, SIGMA, LENGTH = Grid((48, 48, 48), (1.0, 1.0, 1.0)), 1.2, 30.0
SCALES = (0.4, 0.6, 0.8, 1.0, 1.25, 1.6, 2.0)
SHIFTS = (0.1, 0.2, 0.3, 0.4, 0.5)
DIRECTIONS = ((0.0, 1.0, 0.0), (0.577, 0.577, -0.577))
PEAKS = (20.0, 10.0, 5.0, 2.0, 1.0)
# A start is survived if the surface ends within this distance of the truth, in the mean. Noise
# alone moves a surface by more, so that the experiment with noise has its own.
SUCCESS, SUCCESS_IN_NOISE = 0.25, 1.0
METHODS = {
    "coarse to fine": FitSettings(collisions=False),
    # The paper's loss counts every voxel and weights it by the image; lambda is the paper's.
    "one scale": FitSettings(
        levels=(1.0,),
        collisions=False,
        remesh=False,
        smoothing=50,
        likelihood="paper",
        reach=8,
    ),
}
PATIENCE = 600  # iterations that the descent at one scale is given, whether it still moves or not


@dataclass(frozen=True)
class Trial:
    """One fit: the experiment, what was varied, and how it ended."""

    experiment: str
    value: float
    target: str
    method: str
    distance: float  # voxels, mean of both ways; inf where the fit failed
    iterations: int
    seconds: float
    message: str

    @property
    def succeeded(self) -> bool:
        """Whether the surface was found."""
        return self.distance <= bar(self.experiment)


def bar(experiment: str) -> float:
    """Voxels: a surface that ends within this mean distance of the truth was found."""
    return SUCCESS_IN_NOISE if experiment == "noise" else SUCCESS


@dataclass(frozen=True)
class Start:
    """Where a fit begins: the experiment, what is varied, image and truth."""

    experiment: str
    value: float
    target: str
    truth: Mesh
    mesh: Mesh
    image: NDArray[np.float32]


def size(mesh: Mesh) -> tuple[NDArray[np.float64], float]:
    """Centroid of a surface and the root mean square distance of its points from there."""
    points = mesh.vertices_numpy()[mesh.faces].mean(1)
    areas = mesh.areas()
    center = np.average(points, axis=0, weights=areas)
    square = ((points - center) ** 2).sum(1)
    return center, float(np.sqrt(np.average(square, weights=areas)))


def starts(
    folder: Path, names: Sequence[str], quick: bool = False, seed: int = 0
) -> Iterable[Start]:
    """Every experiment; the seed is of the noise."""
    for name in names:
        truth = target(folder, name, GRID, LENGTH)
        center, radius = size(truth)
        clean = render(truth, GRID, GaussianPSF(SIGMA), 1e-5).float().numpy()
        begin = sphere(center, 0.8 * radius, subdivisions=4)
        for scale in SCALES[::3] if quick else SCALES:
            mesh = sphere(center, scale * radius, subdivisions=4)
            yield Start("scale", scale, name, truth, mesh, clean)
        for shift in SHIFTS[1::3] if quick else SHIFTS:
            for direction in DIRECTIONS[:1] if quick else DIRECTIONS:
                mesh = begin.translated(shift * LENGTH * np.asarray(direction))
                yield Start("shift", shift, name, truth, mesh, clean)
        for peak in PEAKS[1::3] if quick else PEAKS:
            noise = np.random.default_rng(seed + int(peak)).normal(size=GRID.shape)
            image = clean + noise.astype(np.float32) * clean.max() / peak
            yield Start("noise", peak, name, truth, begin, image)


def trials(folder: Path, names: Sequence[str], quick: bool) -> Iterable[Trial]:
    """Every experiment with every method."""
    for start in starts(folder, names, quick):
        for method, settings in METHODS.items():
            yield _tried(start, method, settings)


def _tried(start: Start, method: str, settings: FitSettings) -> Trial:
    began = time.perf_counter()
    distance, iterations = np.inf, 0
    try:
        patience = 0 if settings.levels is None else PATIENCE
        last = _last(start.image, start.mesh, settings, patience)
        iterations, message = last.iteration, last.message
        distance = surface_distance(last.mesh, start.truth, samples=10000).mean
    except Exception as error:  # a fit that breaks down is a result too
        message = f"{type(error).__name__}: {error}"
    seconds = time.perf_counter() - began
    what = start.experiment, start.value, start.target
    return Trial(*what, method, distance, iterations, seconds, message)


def _last(
    image: NDArray[np.float32], start: Mesh, settings: FitSettings, patience: int
) -> FitState:
    """The last state; a fit that ends before it has used its patience is sent on."""
    states = fit(image, GRID, start, GaussianPSF(SIGMA), settings=settings)
    state = next(states)
    try:
        while True:
            ended = bool(state.message) and state.iteration < patience
            state = states.send(Change() if ended else None)
            if patience and state.iteration >= patience:
                return state
    except StopIteration:
        return state


def table(found: Sequence[Trial]) -> str:
    """Markdown: success and median distance, for each value and method."""
    lines = [
        "| experiment | value | "
        + " | ".join(f"{m}: found, distance, iterations" for m in METHODS)
        + " |",
        "|---|---|" + "---|" * len(METHODS),
    ]
    for experiment, value in dict.fromkeys((t.experiment, t.value) for t in found):
        cells = []
        for method in METHODS:
            own = [
                t for t in found if (t.experiment, t.value, t.method) == (experiment, value, method)
            ]
            rate = f"{sum(t.succeeded for t in own)} of {len(own)}"
            distance = median(t.distance for t in own)
            iterations = median(t.iterations for t in own)
            cells.append(f"{rate}, {distance:.3g}, {iterations:.0f}")
        lines.append(f"| {experiment} | {_words(experiment, value)} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _words(experiment: str, value: float) -> str:
    return {
        "scale": f"start x{value:g}",
        "shift": f"by {value:.0%} of the size",
        "noise": f"peak / noise = {value:g}",
    }[experiment]


def picture(found: Sequence[Trial], path: Path) -> None:
    """Distance of every fit against what was varied."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 3.4), layout="constrained")
    axes = figure.subplots(1, 3, sharey=True)
    titles = {
        "scale": "size of the starting sphere",
        "shift": "shift of the start / size of the target",
        "noise": "peak signal / noise",
    }
    for axis, (experiment, title) in zip(axes, titles.items(), strict=True):
        for method, colour in zip(METHODS, ("#1f77b4", "#d62728"), strict=True):
            own = [t for t in found if t.experiment == experiment and t.method == method]
            values = sorted({t.value for t in own})
            place = {
                v: k + (0.12 if method == "one scale" else -0.12) for k, v in enumerate(values)
            }
            distance = [min(max(t.distance, 1e-2), 30) for t in own]
            axis.semilogy([place[t.value] for t in own], distance, ".", color=colour, alpha=0.6)
            middle = [median(min(t.distance, 30) for t in own if t.value == v) for v in values]
            axis.semilogy([place[v] for v in values], middle, "-", color=colour, label=method)
            axis.set_xticks(range(len(values)), [f"{v:g}" for v in values])
        axis.axhline(bar(experiment), color="grey", lw=0.8, ls="--")
        axis.set_xlabel(title)
    axes[0].set_ylabel("mean surface distance, voxels")
    axes[0].legend(frameon=False)
    figure.savefig(path, dpi=110)


def main() -> None:
    """Run, print, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one target, a few values")
    parser.add_argument("--json", type=Path, help="also write every trial there")
    parser.add_argument("--dry", action="store_true", help="leave the page alone")
    options = parser.parse_args()
    found = []
    names = TARGETS[:1] if options.quick else TARGETS
    for trial in trials(default_data_folder(), names, options.quick):
        found.append(trial)
        print(
            f"{trial.experiment} {trial.value:g} {trial.target}, {trial.method}: "
            f"{trial.distance:.3g} voxels, {trial.iterations} iterations, {trial.seconds:.1f} s; "
            f"{trial.message}",
            flush=True,
        )
    if options.json:
        options.json.write_text(json.dumps([asdict(t) for t in found], indent=1))
    print(table(found))
    if not options.dry:
        put_between(PAGE, "robustness", f"{table(found)}\n\n![Distances]({PICTURE})")
        picture(found, PAGE.parent / PICTURE)


if __name__ == "__main__":
    main()
