"""What a fit shows of itself, and what it keeps on disk."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ...common.triple import Triple
from ...common.writing import write_atomically
from ...errors import InputError
from ...geometry.archive import opened
from ...geometry.mesh import Mesh
from ...images.missing import unmasked
from ...optics import Optics
from ...scene import Grid, expected_image
from ...scene.effects import Effects
from ...scene.light import MEMBRANES, Light
from .dimmed import with_nuclei


@dataclass(frozen=True, eq=False)
class FitState:
    """One iteration of a fit; owns its arrays.

    Attributes
    ----------
    iteration, level, levels
        Count from 1; the level of the coarse-to-fine schedule and how many there are.
    mesh, optics
        As they are now.
    density
        (F,) fluorophores per um^2 relative to the mean.
    loss
        Weighted residual relative to the variance of the voxels that count: 1 explains nothing.
    amplitude, background
        Measured image = amplitude * rendered image + background.
    effects
        Optional parts of image formation, with their numbers as they are now.
    light
        What shines: membranes, insides, or both, and how much of each.
    blur
        Width of both images at this level, in widths of the PSF.
    converged
        Whether this is the last state and the criterion was met.
    message
        A verdict or a warning in plain words; mostly empty.
    moving
        um: where the surface of a fit that has converged still moves; None where it rests.
    pinned
        (V,) bool: vertices that were told to stay; None where none were.
    events
        Changes of topology since the last state, a sentence each.
    evaluations
        Renderings with their gradient so far.
    cone
        Whether the image shows the light cone of an objective, which this PSF lacks; asked at the
        end of a fit.
    unsure
        Whether membranes may shine in addition to the insides, with surfaces further in; of both,
        whether insides alone may, with surfaces further out.
    dimmed
        (Z, Y, X) float32: what insides show with dark nuclei over what they would without; None
        where none were found.
    counted
        (Z, Y, X) bool: voxels that may count, where that was found anew on the way; None: those
        that were given.
    local_background
        (Z, Y, X) float32: what lies around the cells and was subtracted from the image; None:
        nothing. The rendered image has it.
    grid, accuracy
        Of the image that it renders; an accuracy of 0 is exact.
    """

    iteration: int
    level: int
    levels: int
    mesh: Mesh
    optics: Optics
    density: np.ndarray
    loss: float
    amplitude: float
    background: float
    blur: float
    effects: Effects = field(default_factory=Effects)
    light: Light = MEMBRANES
    converged: bool = False
    message: str = ""
    moving: Triple | None = None
    pinned: np.ndarray | None = None
    events: tuple[str, ...] = ()
    evaluations: int = 0
    cone: bool = False
    unsure: bool = False
    dimmed: np.ndarray | None = None
    counted: np.ndarray | None = None
    local_background: np.ndarray | None = None
    grid: Grid | None = None
    accuracy: float = 0.0
    _image: np.ndarray | None = field(repr=False, default=None)
    _checkpoint: Callable[[], dict[str, np.ndarray]] = field(repr=False, default=dict)

    def rendered(self) -> np.ndarray:
        """(Z, Y, X) float32: what the microscope would show of this state; computed when asked."""
        if self._image is not None:
            return self._image
        assert self.grid is not None, "a state that a fit made knows its grid"
        even = expected_image(
            self.mesh,
            self.grid,
            self.optics,
            self.accuracy,
            self.amplitude,
            self.background,
            density=self.density,
            effects=self.effects,
            light=self.light,
        )
        found = with_nuclei(even, self.dimmed, self.background, self.effects, self.grid)
        return found if self.local_background is None else found + self.local_background

    def without_local_background(self, image: np.ndarray) -> np.ndarray:
        """(Z, Y, X) an image of this scene as the fit explains it."""
        if self.local_background is None:
            return image
        return np.asarray(unmasked(image) - self.local_background, np.float32)

    def showing(self, image: np.ndarray) -> FitState:
        """The same, with its image, which was rendered already."""
        return replace(self, _image=image)

    def save(self, path: str | Path) -> None:
        """Write a checkpoint that ``fit(..., resume=path)`` goes on from."""
        buffer = io.BytesIO()
        np.savez(buffer, **self._checkpoint())  # type: ignore[arg-type]
        write_atomically(path, buffer.getvalue())


def load_checkpoint(path: str | Path) -> dict[str, np.ndarray]:
    """Read what :meth:`FitState.save` wrote.

    Raises
    ------
    InputError
        If the file is missing, damaged or no checkpoint.
    """
    with opened(path, "a checkpoint") as archive:
        names = [name.removesuffix(".npy") for name in archive.names if name.endswith(".npy")]
        kept = {name: archive.array(name) for name in names}
    if not {"vertices", "faces", "optics", "levels"} <= set(kept):
        raise InputError(f"{path} is not a checkpoint of a fit")
    return kept
