"""The numbers of the PSF and of the effects that a fit changes: at its start, and now."""

from __future__ import annotations

from dataclasses import dataclass

from ..fitting import FitState
from ..fitting.job import FitInput
from ..optics import GaussianPSF
from .report import effects_found


@dataclass(frozen=True)
class MovedNumber:
    """A number that a fit changes; ``start`` is None if it had no value before."""

    name: str
    unit: str
    start: float | None
    now: float

    @property
    def texts(self) -> tuple[str, str, str]:
        """Name, start and present value, as they are shown."""
        start = "-" if self.start is None else f"{self.start:.4g}"
        return self.name, start, f"{self.now:.4g} {self.unit}".strip()


def moved_numbers(state: FitState, job: FitInput) -> list[MovedNumber]:
    """Return the numbers that the fit of a job changes: of the PSF, and of the effects."""
    found = []
    if isinstance(state.optics, GaussianPSF):
        pairs = zip("zyx", job.optics.sigma_um, state.optics.sigma_um, strict=True)
        found += [MovedNumber(f"PSF, width along {a}", "µm", b, c) for a, b, c in pairs if b != c]
        if not state.optics.diagonal:
            given = job.optics.tilt if isinstance(job.optics, GaussianPSF) else (0.0, 0.0)
            tilts = zip("YX", given, state.optics.tilt, strict=True)
            found += [MovedNumber(f"PSF, tilt towards {a}", "°", b, c) for a, b, c in tilts]
    elif job.settings.fit.fit_psf:
        before = {p.name: p.value for p in job.optics.described()}
        found += [
            MovedNumber(p.name.replace("_", " "), p.unit, before.get(p.name), p.value)
            for p in state.optics.described()
            if p.fitted
        ]
    for effect in effects_found(job.settings.scene.effects, state.effects):
        title = str(effect["name"]).replace("_", " ")
        for number in effect["numbers"] if effect["fitted"] else []:
            name = f"{title}: {str(number['name']).replace('_', ' ')}"
            unit = "" if number["unit"] == "1" else str(number["unit"])
            found.append(MovedNumber(name, unit, number["start"], number["value"]))
    return found
