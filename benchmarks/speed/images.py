"""An image with its gradient: time, memory, and FINUFFT at the same error and points."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from napari_deltamic import GaussianPSF, Grid, Mesh, render

from ..clusters import foams
from ..figure import SIGMA, cow, scene, sphere_of
from .jobs import Bench, Job, mesh_arrays
from .lines import Bar, Case, Line, at_most, compared, faster, line

EXACT = 1e-6  # accuracy of the image that others are measured against


@dataclass(frozen=True)
class Setting:
    """What is rendered."""

    name: str
    mesh: Mesh
    grid: Grid
    sigma: float
    accuracy: float

    def job(self, task: str, repeats: int, save: bool) -> Job:
        """An image with its gradient, so many times."""
        values = {
            "shape": list(self.grid.shape),
            "voxel_size": list(self.grid.voxel_size),
            "sigma": [self.sigma] * 3,
            "accuracy": self.accuracy,
            "repeats": repeats,
            "save": save,
        }
        return Job(self.name, task, mesh_arrays(self.mesh), values)

    def exact(self) -> np.ndarray:
        """The image to high accuracy."""
        optics = GaussianPSF(self.sigma)
        return render(self.mesh, self.grid, optics, EXACT).detach().double().numpy()


def cow_in(voxels: int, bench: Bench) -> Setting:
    """The cow over 70 % of a cube."""
    return Setting(f"cow, {voxels}^3, 1e-3", cow(bench, voxels), scene(voxels)[0], SIGMA, 1e-3)


def large(bench: Bench) -> Setting:
    """20,000 faces in 500^3 voxels."""
    side = 200 if bench.quick else 500
    mesh = sphere_of(20_000, side, 0.4 * side)
    name = f"{side}^3, {len(mesh.faces)} faces, 1e-3"
    return Setting(name, mesh, scene(side)[0], SIGMA, 1e-3)


def small_image(voxels: int, bar: Bar, bench: Bench) -> list[Line]:
    """Milliseconds, and the error of image and gradient."""
    setting = cow_in(voxels, bench)
    repeats = 5 if bench.quick else 15
    pair = bench.both(setting.job("render", repeats, save=True), rounds=2 if bench.quick else 5)
    exact = setting.exact()

    def error(side) -> float:  # type: ignore[no-untyped-def]
        return _error(pair.each[side][0].arrays["image"], exact)

    def ms(name: str) -> Callable[..., float]:
        return lambda side: 1e3 * pair.median(side, name)

    points = " and ".join(
        f"{each[0].number('points'):.0f} points ({side})" for side, each in pair.each.items()
    )
    what = f"image + gradient, {setting.name}"
    return [
        compared(what, "ms", pair, ms("seconds"), bar, points),
        compared(f"{what}, and the plan", "ms", pair, ms("first")),
        compared(f"{what}, error", "", pair, error, at_most(setting.accuracy)),
    ]


def large_image(bench: Bench) -> list[Line]:
    """Seconds and the most memory."""
    setting = large(bench)
    pair = bench.both(setting.job("render", 2, save=False))
    what = f"image + gradient, {setting.name}"
    return [
        compared(what, "s", pair, "seconds", at_most(2.0)),
        compared(f"{what}, and the plan", "s", pair, "first"),
        compared(
            f"{what}, peak memory",
            "GB",
            pair,
            lambda side: pair.each[side][0].peak_gb,
            at_most(2.2),
        ),
    ]


def against_finufft(bench: Bench) -> list[Line]:
    """FINUFFT with as many points and no larger error, beside the present tree."""
    settings = [cow_in(100, bench)]
    if not bench.quick:
        known = foams.scene(32)
        settings.append(Setting("foam of 32, 1e-2", known.truth, known.grid, SIGMA, 1e-2))
        settings.append(cow_in(200, bench))
    lines = []
    for setting in settings:
        job = setting.job("render", 15, save=True)
        pair = bench.both(job, rounds=1 if bench.quick else 3, only="present")
        ours, exact = pair.first("present"), setting.exact()
        if ours is None or ours.failed:
            lines.append(compared(f"FINUFFT, {setting.name}", "", pair, "seconds"))
            continue
        error = _error(ours.arrays["image"], exact)
        given = {**job.arrays, "exact": exact.astype(np.float32)}
        asked = Job(job.name, "finufft", given, {**job.values, "error": error})
        other = bench.both(asked, rounds=1 if bench.quick else 3, only="present")
        theirs = other.first("present")
        assert theirs is not None, "the present side ran just before"
        points = f"{ours.number('points'):.0f} and {theirs.number('points'):.0f} points"
        note = f"errors {error:.2g} and {theirs.number('error'):.2g}; {points}; {theirs.failed}"
        one, two = other.median("present", "seconds"), pair.median("present", "seconds")
        what = f"FINUFFT (as baseline), {setting.name}"
        lines.append(line(f"{what}", "ms", 1e3 * one, 1e3 * two, faster(3), note.rstrip("; ")))
    return lines


def _error(image: np.ndarray, exact: np.ndarray) -> float:
    return float(np.linalg.norm(image - exact) / np.linalg.norm(exact))


CASES: dict[str, Case] = {
    "image-100": partial(small_image, 100, at_most(10.0)),
    "image-200": partial(small_image, 200, at_most(80.0)),
    "image-500": large_image,
    "finufft": against_finufft,
}
