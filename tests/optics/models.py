"""One PSF of every kind with parameters, as the tests of them share."""

import torch

from napari_deltamic import optics
from napari_deltamic.optics.objective import without_defocus

EXTENT = (1.2, 0.9)  # um: small, for speed; what is tested hangs on no extent

LAYERS = {
    "na": 1.1,
    "wavelength": 0.52,
    "index": 1.515,
    "sample_index": 1.38,
    "depth": 3.0,
    "coverslip": 168.0,
    "coverslip_index": 1.523,
    "design_index": 1.512,
    "design_coverslip": 170.0,
    "design_coverslip_index": 1.525,
    "working_distance": 150.0,
}
SCALAR = {"na": 1.2, "wavelength": 0.52, "index": 1.515, "apodisation": 0.3}
PUPIL = {"na": 0.9, "wavelength": 0.52, "index": 1.0, "apodisation": 0.1}
PHASES = {5: 0.4, 7: -0.3, 11: 0.25}
AMPLITUDES = {6: 0.1}


def scalar(fitted=(), extent=EXTENT, **values):
    return optics.ScalarPSF(**{**SCALAR, **values}, fitted=fitted, extent=extent)


def gibson_lanni(fitted=(), extent=EXTENT, **values):
    return optics.GibsonLanniPSF(**{**LAYERS, **values}, fitted=fitted, extent=extent)


def vectorial(fitted=(), extent=EXTENT, **values):
    return optics.VectorialPSF(**{**LAYERS, **values}, fitted=fitted, extent=extent)


def pupil(fitted=(), **values):
    phases = {j: values.pop(f"z{j}", phase) for j, phase in PHASES.items()}
    logs = {j: values.pop(f"a{j}", log) for j, log in AMPLITUDES.items()}
    return optics.PupilPSF(
        **{**PUPIL, **values}, zernike=phases, amplitude=logs, fitted=fitted, extent=EXTENT
    )


def confocal(fitted=(), disk=False, **values):
    own = {"excitation": values.pop("excitation", 0.488), "pinhole": values.pop("pinhole", 0.8)}
    return optics.ConfocalPSF(scalar(**values), **own, disk=disk, fitted=fitted, extent=(1.0, 0.8))


def spinning_disk(fitted=(), **values):
    return confocal(fitted, disk=True, **values)


def light_sheet(fitted=(), **values):
    sheet = values.pop("sheet", 1.5)
    return optics.LightSheetPSF(pupil(**values), sheet, fitted=fitted)


def mixture(fitted=(), **values):
    sigmas = [[0.3, 0.12, 0.13], [0.7, 0.35, 0.4]]
    for c, three in enumerate(sigmas, 1):
        for k, axis in enumerate("zyx"):
            three[k] = torch.as_tensor(values.pop(f"sigma{c}_{axis}", three[k]))
    masses = (1.0, values.pop("mass2", 0.4))
    return optics.GaussianMixturePSF([torch.stack(s) for s in sigmas], masses, fitted=fitted)


MODELS = {
    "scalar": scalar,
    "gibson-lanni": gibson_lanni,
    "vectorial": vectorial,
    "pupil": pupil,
    "confocal": confocal,
    "spinning disk": spinning_disk,
    "light sheet": light_sheet,
    "mixture": mixture,
}


def axes(kz=(-3.0, -1.0, 0.0, 1.5, 4.0), ky=(-9.0, 0.0, 5.0), kx=(0.0, 4.0, 11.0)):
    """A small box of wavevectors."""
    z, y, x = (torch.tensor(k, dtype=torch.float64) for k in (kz, ky, kx))
    return z[:, None, None], y[None, :, None], x[None, None, :]


def focal_shift(model):
    """um: the focus has to be set this much deeper than the structure to see it sharp."""
    s, weight = model._rho * model._aperture(), model._rho * model._rho_weight
    v = model._values
    _, defocus = without_defocus(model._layers(s), s, v["index"], weight)
    return float(defocus + v["working_distance"] - v["depth"])
