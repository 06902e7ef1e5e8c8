"""Effects on simulated scenes: what leaving one out does to the shape, what fitting it mends."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from napari_deltamic import GaussianPSF, Grid, Mesh, fit
from napari_deltamic.geometry import sphere
from napari_deltamic.geometry.foam import foam
from napari_deltamic.measure import surface_distance
from napari_deltamic.runs.settings import NEAR_LEVELS, FitSettings
from napari_deltamic.scene import expected_image
from napari_deltamic.scene.effects import (
    Attenuation,
    Background,
    Bleaching,
    DepthPSF,
    Effect,
    Effects,
    Halo,
    Illumination,
)

PHOTONS, DARK = 40.0, 2.0  # at the peak, and of the background
VOXEL = (0.4, 0.2, 0.2)
SIGMA = (0.5, 0.25, 0.25)


@dataclass(frozen=True)
class Scene:
    """Surfaces to be found, coarser ones to start from, and the grid of their image."""

    name: str
    truth: Mesh
    coarse: Mesh
    grid: Grid


def scenes() -> list[Scene]:
    """A sphere, an ellipsoid, and two cells with a wall."""
    small = Grid((26, 44, 44), VOXEL)
    wide = Grid((26, 44, 60), VOXEL)
    middle = np.array([5.0, 4.3, 4.3])
    pair = np.array([[5.0, 4.3, 4.5], [5.0, 4.3, 7.3]])
    radii = np.array([2.0, 2.0])
    return [
        Scene("sphere", *(sphere(middle, 2.5, subdivisions=n) for n in (5, 3)), small),
        Scene(
            "ellipsoid",
            *(sphere(middle, (3.0, 2.0, 2.5), subdivisions=n) for n in (5, 3)),
            small,
        ),
        Scene("two cells", *(foam(pair, radii, edge) for edge in (0.25, 0.4)), wide),
    ]


def cases() -> list[tuple[str, Effect]]:
    """What is simulated: a name for people, and the effect with its true numbers."""
    return [
        ("attenuation 2 %/um", Attenuation(per_um=0.02)),
        ("background gradient, 4 photons", Background(coefficients=(3.0, 2.0, -2.0))),
        ("halo 5 %, 1.5 um", Halo(fraction=0.05, width=1.5)),
        ("bleaching 2 % a slice", Bleaching(per_slice=0.02)),
        ("illumination 10 %", Illumination(coefficients=(0.1, -0.05, -0.05, 0.0, -0.05))),
        ("PSF widens with depth", DepthPSF(variance_z=0.15, variance_yx=0.03)),
    ]


@dataclass(frozen=True)
class Outcome:
    """One simulated scene and three fits of it.

    Attributes
    ----------
    left_out, held, fitted
        um, mean distance to the true surface: without the effect, with it as it truly is, and with
        its numbers fitted.
    true, found
        Name -> number of the effect.
    iterations
        Of the three fits.
    """

    scene: str
    case: str
    left_out: float
    held: float
    fitted: float
    true: dict[str, float]
    found: dict[str, float]
    iterations: tuple[int, int, int]


def simulate(scene: Scene, effect: Effect, seed: int | None) -> np.ndarray:
    """Photons in each voxel: a peak of 40 above a background of 2; without noise for seed None."""
    optics = GaussianPSF(SIGMA)
    plain = expected_image(scene.truth, scene.grid, optics, 1e-4, 1.0, 0.0)
    amplitude = PHOTONS / float(plain.max())
    image = expected_image(
        scene.truth, scene.grid, optics, 1e-4, amplitude, DARK, effects=Effects.of(effect)
    )
    if isinstance(effect, Background):
        image = image - min(float(image.min()), 0.0)
    if seed is None:
        return image
    return np.random.default_rng(seed).poisson(image.clip(0)).astype(np.float32)


def compare(
    scene: Scene, case: str, effect: Effect, seed: int | None = 0, fit_psf: bool = False
) -> Outcome:
    """Fit without the effect, with its true numbers, and with its numbers fitted."""
    image = simulate(scene, effect, seed)
    settings = FitSettings(levels=NEAR_LEVELS, fit_psf=fit_psf)
    v = scene.coarse.vertices_numpy()
    start = scene.coarse.with_vertices(v.mean(0) + 0.93 * (v - v.mean(0)) + [0.15, 0.1, -0.1])
    names = [value.name for value in effect.values()]
    errors, iterations = [], []
    last = None
    for effects in (
        Effects(),
        Effects.of(effect.model_copy(update={"fit": False})),
        Effects.of(effect.name),
    ):
        optics = GaussianPSF(SIGMA)
        *_, last = fit(image, scene.grid, start, optics, settings=settings, effects=effects)
        errors.append(surface_distance(last.mesh, scene.truth, 20_000).mean)
        iterations.append(last.iteration)
    assert last is not None
    (found,) = last.effects.present()
    return Outcome(
        scene.name,
        case,
        *errors,
        true=dict(zip(names, (value.value for value in effect.values()), strict=True)),
        found=dict(zip(names, (value.value for value in found.values()), strict=True)),
        iterations=(iterations[0], iterations[1], iterations[2]),
    )


def outcomes(quick: bool = False, seed: int | None = 0, fit_psf: bool = False) -> Iterator[Outcome]:
    """Every case on every scene; only on the sphere where it has to be quick."""
    for case, effect in cases():
        for scene in scenes()[: 1 if quick else None]:
            yield compare(scene, case, effect, seed, fit_psf)


def shape_table(quick: bool = False) -> str:
    """The table, as Markdown: distances in nm, left out / true numbers / fitted."""
    names = [scene.name for scene in scenes()[: 1 if quick else None]]
    rows = [
        "| effect | " + " | ".join(names) + f" | true and found number, {names[-1]} |",
        "|---" * (len(names) + 2) + "|",
    ]
    found: dict[str, list[Outcome]] = {}
    for o in outcomes(quick):
        print(o, file=sys.stderr, flush=True)
        found.setdefault(o.case, []).append(o)
    for case, each in found.items():
        errors = [
            " / ".join(f"{1000 * e:.1f}" for e in (o.left_out, o.held, o.fitted)) for o in each
        ]
        true, numbers = (
            " ".join(f"{v:.3g}" for v in d.values()) for d in (each[-1].true, each[-1].found)
        )
        rows.append("| " + " | ".join([case, *errors, f"{true}; {numbers}"]) + " |")
    note = "Left out / true numbers / fitted, nm; one draw of the noise."
    return "\n".join([*rows, "", note])
