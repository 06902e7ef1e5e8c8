"""Figures of the optics: PSF and shape fitted together, a measured PSF, a bead with its PSF."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_deltamic import GaussianPSF, Grid, MeasuredPSF, Mesh, PupilPSF, fit, microscope, render
from napari_deltamic.geometry import sphere
from napari_deltamic.images import read_image
from napari_deltamic.inference.bead import BeadFit, fit_bead
from napari_deltamic.inference.psf_errors import psf_standard_errors
from napari_deltamic.optics import Optics
from napari_deltamic.optics.measured import bead_transform
from napari_deltamic.settings import FitSettings

from ..figure import Figure, MissingData, Options, Row, at_least, at_most

GRID = Grid((24, 40, 40), (0.2, 0.1, 0.1))
CENTRE = (2.3, 1.95, 1.95)
PHOTONS, DARK = 40, 2
RUNS, QUICK_RUNS = 20, 4
WITHIN = 3  # standard errors
MEASURED = "MEASURED_wl520_na0.85_n1.0_xy130_z300nm.tif"
MEASURED_VOXEL = (0.3, 0.13, 0.13)
BEAD, BEAD_PSF = "bead2.5um_EPFL_25pct.tif", "THEOR_EPFL_bead_25pct.tif"
BEAD_VOXEL, DIAMETER = (0.64, 0.258, 0.258), 2.5


# --------------------------------------------------------------------- PSF and shape together


def _cell() -> Mesh:
    """A sphere with bulges, which no few numbers describe."""
    mesh = sphere(CENTRE, 1.0, subdivisions=4)
    v = mesh.vertices_numpy().copy()
    d = v - CENTRE
    v += 0.12 * d * np.sin(2.2 * d[:, 2:3]) + 0.08 * d * np.cos(3 * d[:, 1:2])
    return mesh.with_vertices(v)


def _pupil(phases: dict[int, float]) -> PupilPSF:
    return PupilPSF(0.8, 0.52, 1.333, phases, extent=(1.5, 1.5))


SCENES: dict[str, tuple[Optics, Optics]] = {
    "Gaussian": (GaussianPSF((0.35, 0.14, 0.14)), GaussianPSF((0.45, 0.18, 0.18))),
    "pupil, 4 Zernikes": (
        _pupil({5: 0.4, 6: -0.3, 7: 0.3, 11: 0.3}),
        _pupil({5: 0.0, 6: 0.0, 7: 0.0, 11: 0.0}),
    ),
}


def psf_joint(options: Options) -> list[Row]:
    """Share of PSF parameters within 3 standard errors of the truth, fitted with the shape."""
    rows = []
    for name, (true, start) in SCENES.items():
        expected = render(_cell(), GRID, true, 1e-4).numpy().astype(float)
        expected = DARK + PHOTONS * expected.clip(0) / expected.max()
        scores = []
        for seed in range(QUICK_RUNS if options.quick else RUNS):
            image = np.random.default_rng(seed).poisson(expected).astype(float)
            scores.append(_scores(image, true, start))
        z = np.abs(np.concatenate(scores))
        note = f"{len(z)} numbers, rms {np.sqrt((z**2).mean()):.2f}, largest {z.max():.2f}"
        row = at_least(
            f"within {WITHIN} standard errors: {name}", 95, 100 * (z < WITHIN).mean(), "%"
        )
        rows.append(Row(**{**asdict(row), "note": note}))
    return rows


def _scores(image: NDArray, true: Optics, start: Optics) -> NDArray[np.float64]:
    """(P,) error of each parameter in standard errors."""
    settings = FitSettings(fit_psf=True)
    *_, last = fit(image, GRID, sphere(CENTRE, 0.8, subdivisions=3), start, settings=settings)
    errors = psf_standard_errors(last, GRID, np.maximum(last.rendered(), 0.5))
    truth = {p.name: p.value for p in true.described()}
    found = {p.name: p.value for p in last.optics.described() if p.fitted}
    return np.array([(found[n] - truth[n]) / e for n, e in errors.items()])


# ---------------------------------------------------------------------------- a measured PSF


def psf_measured(options: Options) -> list[Row]:
    """What a pupil model leaves of a measured PSF, and of a simulated one."""
    image = _read(options, "psf", MEASURED)[4:21, 108:149, 111:152]
    named = PupilPSF(0.85, 0.52, 1.0, {5: 0.0, 6: 0.0, 7: 0.0, 8: 0.0, 11: 0.0},
                     fitted=("na", "z5", "z6", "z7", "z8", "z11"), extent=(2.0, 2.0))  # fmt: skip
    first = fit_bead(image, MEASURED_VOXEL, named, bead_diameter=None, iterations=15)
    rows = [_residual("measured PSF, 5 Zernikes", first, image)]
    if not options.quick:
        rows.append(
            _residual("measured PSF, 19 Zernikes, amplitude", _refined(image, first), image)
        )
    true = named.with_parameters(first.optics.parameters())
    rows.append(_simulated(true, named, first))
    return rows


def _refined(image: NDArray, first: BeadFit) -> BeadFit:
    phases = {j: 0.0 for j in (*range(5, 23), 37)}
    logs = {j: 0.0 for j in (5, 6, 7, 8, 11, 22)}
    names = ("na", "apodisation", *(f"z{j}" for j in phases), *(f"a{j}" for j in logs))
    richer = PupilPSF(0.85, 0.52, 1.0, phases, 0.0, logs, fitted=names, extent=(2.0, 2.0))
    known = first.optics.values  # type: ignore[attr-defined]
    start = richer._with_values({n: known.get(n, v) for n, v in richer.values.items()})
    return fit_bead(image, MEASURED_VOXEL, start, bead_diameter=None, iterations=40)


def _residual(name: str, found: BeadFit, image: NDArray) -> Row:
    signal = np.linalg.norm(image - found.background)
    values = {p.name: p.value for p in found.optics.described()}
    note = (
        f"residual {np.linalg.norm(found.residual) / signal:.1%} of the signal, "
        f"NA {values['na']:.3f} (named 0.85), bead {found.bead_diameter:.2f} um"
    )
    return at_most(f"{name}: residual over noise", 1.2, float(np.sqrt(found.chi2)), "sd", note)


def _simulated(true: Optics, start: Optics, like: BeadFit) -> Row:
    """The same bead, simulated: what the fit leaves where the model is right."""
    grid = Grid(like.rendered.shape, MEASURED_VOXEL)  # type: ignore[arg-type]
    gain = 2.2
    clean = like.rendered
    noisy = gain * np.random.default_rng(0).poisson(np.maximum(clean, 0) / gain)
    found = fit_bead(noisy, grid.voxel_size, start, bead_diameter=None, iterations=20)
    noise = np.sqrt(gain * np.maximum(clean, 1.0))
    left = float(np.sqrt(np.mean((found.residual / noise) ** 2)))
    return at_most("simulated PSF of the same optics: residual over noise", 1.05, left, "sd")


# ---------------------------------------------------------------------------- a bead of 2.5 um


def bead(options: Options) -> list[Row]:
    """Diameter of a bead with its PSF and without."""
    rows = []
    true = microscope("widefield", na=1.0, wavelength=0.53, immersion="water", model="scalar")
    image = _bead_image(true)
    for name, psf in (("with its PSF", true), ("without", _sharp())):
        found = _diameter(image, psf)
        off = 100 * abs(found / DIAMETER - 1)
        figure, note = f"simulated bead {name}: error of its diameter", f"{found:.3f} um"
        rows.append(at_most(figure, 2, off, "%", note) if psf is true
                    else Row(figure, "", off, "%", None, note))  # fmt: skip
    try:
        image = _read(options, "images", BEAD)
        measured = MeasuredPSF(_read(options, "psf", BEAD_PSF), BEAD_VOXEL)
    except MissingData as missing:
        return [*rows, Row("real bead", "", float("nan"), "", None, str(missing))]
    for name, psf in (("with its theoretical PSF", measured), ("without", _sharp())):
        for kind in ("solid", "shell"):
            found = _diameter(image, psf, kind)
            off = 100 * abs(found / DIAMETER - 1)
            figure, note = f"real bead {name}, {kind}: error of its diameter", f"{found:.3f} um"
            rows.append(at_most(figure, 2, off, "%", note) if psf is measured
                        else Row(figure, "", off, "%", None, note))  # fmt: skip
    return rows


def _sharp() -> Optics:
    """Hardly a PSF at all."""
    z, y, x = (0.25 * d for d in BEAD_VOXEL)
    psf = GaussianPSF((z, y, x))
    psf.limits = lambda: (psf.parameters(), psf.parameters())  # type: ignore[method-assign]
    return psf


def _bead_image(psf: Optics) -> NDArray[np.float64]:
    import torch

    from napari_deltamic.fourier import Band

    band = Band.full((48, 80, 80), BEAD_VOXEL)
    z, y, x = band.axes()
    spectrum = psf.otf((z, y, x)) * bead_transform(
        torch.sqrt(z * z + y * y + x * x) * (DIAMETER / 2), "solid"
    )
    pixel = torch.sinc(y * (BEAD_VOXEL[1] / (2 * np.pi))) * torch.sinc(
        x * (BEAD_VOXEL[2] / (2 * np.pi))
    )
    at = (7.7, 4.2, 4.1)
    for k, c in zip((z, y, x), at, strict=True):
        spectrum = spectrum * torch.exp(-1j * k * c)
    clean = band.to_image(spectrum * pixel, (24, 32, 32)).numpy()
    clean = 20 + 500 * clean.clip(0) / clean.max()
    return np.random.default_rng(0).poisson(clean).astype(float)


def _diameter(image: NDArray, psf: Optics, kind: Any = "solid") -> float:
    held = psf.with_parameters(psf.parameters()) if not isinstance(psf, MeasuredPSF) else psf
    if held is not psf and not isinstance(psf, GaussianPSF):
        held = type(psf)(**psf.values, fitted=())  # type: ignore[attr-defined]
    elif isinstance(psf, GaussianPSF):
        held = psf
    return fit_bead(image, BEAD_VOXEL, held, bead_diameter=None, bead=kind).bead_diameter


def _read(options: Options, folder: str, name: str) -> NDArray:
    path = options.data / folder / name
    if not path.is_file():
        raise MissingData(f"no {name} in {path.parent} (DELTAMIC_DATA names the folder)")
    return read_image(path)[0]


FIGURES: dict[str, Figure] = {"psf_joint": psf_joint, "psf_measured": psf_measured, "bead": bead}
