"""Figures of the optics: PSF and shape fitted together, a measured PSF, a bead with its PSF."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_deltamic import (
    GaussianPSF,
    GibsonLanniPSF,
    Grid,
    MeasuredPSF,
    Mesh,
    PupilPSF,
    fit,
    microscope,
    render,
)
from napari_deltamic.evidence.camera import camera_from_image
from napari_deltamic.geometry import sphere
from napari_deltamic.images.stacks import read_image
from napari_deltamic.optics import Optics
from napari_deltamic.optics.measured import bead_transform
from napari_deltamic.runs.settings import FitSettings

from ..figure import Figure, MissingData, Options, Row, at_least, at_most
from .bead_fit import BeadFit, fit_bead
from .psf_errors import psf_standard_errors

GRID = Grid((24, 40, 40), (0.2, 0.1, 0.1))
CENTRE = (2.3, 1.95, 1.95)
PHOTONS, DARK = 40, 2
RUNS, QUICK_RUNS = 20, 4
WITHIN = 3  # standard errors
MEASURED = "MEASURED_wl520_na0.85_n1.0_xy130_z300nm.tif"
MEASURED_VOXEL = (0.3, 0.13, 0.13)
GAIN = 2.2  # counts per photon of its camera
NOISE = 1.05  # residual over noise: all is explained
ACQUISITION = ("brightness", "background", "drift", "focus", "motion", "axial blur")
BEAD_ACQUISITION = ("brightness", "background", "drift", "motion", "axial blur")
BEAD, BEAD_PSF = "bead2.5um_EPFL_25pct.tif", "THEOR_EPFL_bead_25pct.tif"
HELD = (2.3, 2.5, 2.7, 2.9)  # um
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
    errors = psf_standard_errors(image, last, GRID, np.maximum(last.rendered(), 0.5))
    truth = {p.name: p.value for p in true.described()}
    found = {p.name: p.value for p in last.optics.described() if p.fitted}
    return np.array([(found[n] - truth[n]) / e for n, e in errors.items()])


# ---------------------------------------------------------------------------- a measured PSF


def psf_measured(options: Options) -> list[Row]:
    """What a pupil model leaves of a measured PSF, and of a simulated one."""
    whole = np.asarray(_read(options, "psf", MEASURED), float)
    image = whole[4:21, 108:149, 111:152]
    few = _free_pupil((5, 6, 7, 8, 11), ())
    plain = _fitted_pupil(image, few)
    rows = [_residual("measured PSF, 5 Zernikes", plain, image)]
    disturbed = _fitted_pupil(image, few, ACQUISITION)
    rows.append(_residual("measured PSF, 5 Zernikes, acquisition", disturbed, image))
    if not options.quick:
        richer = _free_pupil(range(5, 38), (5, 6, 7, 8, 11, 22), plain.optics)
        rich = _fitted_pupil(image, richer)
        name = "measured PSF, 33 Zernikes, 6 of the amplitude"
        rows.append(_residual(name, rich, image))
        richer = _free_pupil(range(5, 38), (5, 6, 7, 8, 11, 22), rich.optics)
        all_in = _fitted_pupil(image, richer, ACQUISITION)
        rows.append(_residual(f"{name}, acquisition", all_in, image))
    rows += [
        _simulated("simulated PSF of the same optics", few, plain, ()),
        _simulated("simulated, with the same acquisition", few, disturbed, ACQUISITION),
    ]
    rows.append(_beyond("measured PSF", image))
    still = np.random.default_rng(0).poisson(np.maximum(plain.rendered, 0) / GAIN) * GAIN
    rows.append(_beyond("simulated PSF", still))
    return rows


def _free_pupil(phases: Iterable[int], logs: Iterable[int], known: Optics | None = None) -> Optics:
    """The pupil that the file's name tells of, with these Zernikes free."""
    start = {} if known is None else {p.name: p.value for p in known.described()}
    z = {j: start.get(f"z{j}", 0.0) for j in phases}
    a = {j: start.get(f"a{j}", 0.0) for j in logs}
    names = ("na", *(f"z{j}" for j in z), *(f"a{j}" for j in a), *(("apodisation",) if a else ()))
    na, apodisation = start.get("na", 0.85), start.get("apodisation", 0.0)
    return PupilPSF(na, 0.52, 1.0, z, apodisation, a, fitted=names, extent=(2.0, 2.0))


def _fitted_pupil(image: NDArray, start: Optics, disturbances: Sequence[Any] = ()) -> BeadFit:
    return fit_bead(
        image,
        MEASURED_VOXEL,
        start,
        bead_diameter=None,
        disturbances=disturbances,
        iterations=25,
    )


def _residual(name: str, found: BeadFit, image: NDArray) -> Row:
    signal = np.linalg.norm(image - found.background)
    values = {p.name: p.value for p in found.optics.described()}
    note = (
        f"residual {np.linalg.norm(found.residual) / signal:.1%} of the signal, "
        f"NA {values['na']:.3f} (named 0.85), bead {found.bead_diameter:.2f} um"
    )
    if "drift" in found.slices:
        drift, focus = found.slices["drift"], found.slices["focus"]
        jumps = np.abs(np.diff(focus)).max()
        note += (
            f"; drift {1e3 * np.linalg.norm(drift[-1] - drift[0]):.0f} nm over the stack, steps "
            f"off by up to {1e3 * jumps:.0f} nm, axial "
            f"blur {1e3 * found.slices['axial blur']:.0f} nm, "
            f"brightness {100 * found.slices['brightness'].std():.1f} %"
        )
    return at_most(f"{name}: residual over noise", NOISE, float(np.sqrt(found.chi2)), "sd", note)


def _simulated(name: str, start: Optics, like: BeadFit, disturbances: Sequence[Any]) -> Row:
    """The same bead, simulated: what the fit leaves where the model is right."""
    clean = np.maximum(like.rendered, 1.0)
    noisy = GAIN * np.random.default_rng(0).poisson(clean / GAIN)
    found = _fitted_pupil(noisy, start, disturbances)
    left = float(np.sqrt(np.mean(found.residual**2 / (GAIN * clean))))
    return at_most(f"{name}: residual over noise", NOISE, left, "sd")


def _beyond(name: str, image: NDArray) -> Row:
    """Light at wavevectors along Z that no objective of this aperture passes.

    A still bead seen by even steps in even light has none there, whatever its PSF.
    """
    from scipy.signal.windows import hann

    line = camera_from_image(image).line
    assert line is not None
    n = image.shape
    taper = hann(n[0] + 2)[1:-1, None, None] * hann(n[1])[:, None] * hann(n[2])
    power = np.abs(np.fft.fftn((image - np.median(image)) * taper)) ** 2
    noise = float((line.variance(image) * taper**2).sum())
    k = 2 * np.pi / 0.52
    end = k * (1 - np.sqrt(1 - 0.9**2)) + 4 * np.pi / (n[0] * MEASURED_VOXEL[0])
    kz = 2 * np.pi * np.fft.fftfreq(n[0], MEASURED_VOXEL[0])
    ky, kx = (
        2 * np.pi * np.fft.fftfreq(m, d) for m, d in zip(n[1:], MEASURED_VOXEL[1:], strict=True)
    )
    beyond = (np.abs(kz) > end)[:, None, None] & (np.hypot(ky[:, None], kx) < 1.7 * k)
    found = float(np.sqrt(power[beyond].mean() / noise))
    figure = f"{name}: light beyond the end of the OTF along Z, over noise"
    return Row(figure, "", found, "sd", None, "1 for a still bead, even steps and even light")


# ---------------------------------------------------------------------------- a bead of 2.5 um


def bead(options: Options) -> list[Row]:
    """Diameter of a bead with its PSF, with its PSF fitted too, and without."""
    rows = []
    true = _held(
        microscope("widefield", na=1.0, wavelength=0.53, immersion="water", model="scalar")
    )
    for staining, core in (("solid", 0.0), ("rim", 0.6)):
        image = _bead_image(true, core)
        for name, psf in (("with its PSF", true), ("without", _sharp())):
            found = _bead_fit(image, psf, staining)
            asked = psf is true
            rows.append(_diameter(f"simulated {staining} bead {name}", found, image, asked))
    try:
        whole = np.asarray(_read(options, "images", BEAD), float)
        theory = MeasuredPSF(_read(options, "psf", BEAD_PSF), BEAD_VOXEL)
    except MissingData as missing:
        return [*rows, Row("real bead", "", float("nan"), "", None, str(missing))]
    image = whole[13:38, 11:51, 11:51]  # without the beads nearby
    free = GibsonLanniPSF(
        1.4, 0.53, 1.518, sample_index=1.47, depth=5.0, fitted=("na", "depth"), extent=(6.0, 6.0)
    )
    for name, psf, disturbances in (
        ("with its theoretical PSF", theory, ()),
        ("PSF fitted too", free, ()),
        ("PSF and acquisition fitted too", free, BEAD_ACQUISITION),
        ("without", _sharp(), ()),
    ):
        fits = {s: _bead_fit(image, psf, s, disturbances) for s in ("solid", "shell", "rim")}
        # What the image calls for is what leaves least of it.
        best = min(fits, key=lambda s: np.linalg.norm(fits[s].residual))
        for staining, fitted in fits.items():
            asked = staining == best and name != "without"
            rows.append(_diameter(f"real bead {name}, {staining}", fitted, image, asked))
    for disturbances, what in (((), "PSF"), (BEAD_ACQUISITION, "PSF and acquisition")):
        for diameter in HELD:
            fitted = _bead_fit(image, free, "rim", disturbances, diameter)
            note = f"{fitted.core_diameter:.2f} um unstained"
            figure = f"real bead held at {diameter} um, {what} fitted, rim: residual"
            rows.append(Row(figure, "", 100 * _share(fitted, image), "% of the signal", None, note))
    return rows


def _diameter(name: str, found: BeadFit, image: NDArray, asked: bool) -> Row:
    off = 100 * abs(found.bead_diameter / DIAMETER - 1)
    note = f"{found.bead_diameter:.3f} um, residual {_share(found, image):.1%} of the signal"
    if found.core_diameter:
        note += f", {found.core_diameter:.2f} um unstained"
    values = {p.name: p for p in found.optics.described()}
    if "na" in values and values["na"].fitted:
        note += f", NA {values['na'].value:.2f}"
    figure = f"{name}: error of its diameter"
    return at_most(figure, 2, off, "%", note) if asked else Row(figure, "", off, "%", None, note)


def _share(found: BeadFit, image: NDArray) -> float:
    return float(np.linalg.norm(found.residual) / np.linalg.norm(image - found.background))


def _held(psf: Optics) -> Optics:
    """The same PSF, of which nothing is fitted."""
    return type(psf)(**psf.values, fitted=())  # type: ignore[attr-defined,call-arg]


def _sharp() -> Optics:
    """Hardly a PSF at all."""
    z, y, x = (0.25 * d for d in BEAD_VOXEL)
    psf = GaussianPSF((z, y, x))
    psf.limits = lambda: (psf.parameters(), psf.parameters())  # type: ignore[method-assign]
    return psf


def _bead_image(psf: Optics, core: float) -> NDArray[np.float64]:
    import torch

    from napari_deltamic.fourier import Band

    band = Band.full((48, 80, 80), BEAD_VOXEL)
    z, y, x = band.axes()
    spectrum = psf.otf((z, y, x)) * bead_transform(
        torch.sqrt(z * z + y * y + x * x) * (DIAMETER / 2), "solid", core
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


def _bead_fit(
    image: NDArray,
    psf: Optics,
    staining: Any = "solid",
    disturbances: Sequence[Any] = (),
    diameter: float | None = None,
) -> BeadFit:
    return fit_bead(
        image,
        BEAD_VOXEL,
        psf,
        bead_diameter=diameter,
        bead=staining,
        disturbances=disturbances,
        iterations=30,
    )


def _read(options: Options, folder: str, name: str) -> NDArray:
    path = options.data / folder / name
    if not path.is_file():
        raise MissingData(f"no {name} in {path.parent} (DELTAMIC_DATA names the folder)")
    return read_image(path)[0]


FIGURES: dict[str, Figure] = {"psf_joint": psf_joint, "psf_measured": psf_measured, "bead": bead}
