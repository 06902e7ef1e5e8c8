"""The fit: a generator that moves vertices, densities and PSF until the rendered image agrees."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from ..errors import InputError
from ..fourier.plan import check_accuracy
from ..geometry.mesh import Mesh
from ..optics import Optics
from ..scene import Grid, render
from ..settings import EFFECTS, WIDE_LEVELS, FitSettings
from .checks import check_image, check_mesh, hot_voxels
from .density import DensityField
from .health import GrowthAlarm
from .level import FEWEST_VOXELS, Level
from .likelihood import Match, match, noise_ratio, smoothing_for
from .optimiser import AdamUniform
from .preconditioner import Preconditioner, components
from .psf_step import psf_step
from .state import FitState, load_checkpoint

_WINDOW = 12  # iterations over which a level must gain
# A coarse level ends when its window gains less than this share of the loss, or moves the vertices
# by less than this share of its width: it only has to bring the next one within reach.
_COARSE_GAIN, _COARSE_STILL = 0.05, 0.04
_STILL = 0.02  # the same at the last level
_SETTLE = 2  # times the last level halves its step before it counts as converged
_PSF_EVERY = 5
_EXPLAINS_NOTHING = 0.97  # loss at the end from which on nothing was found
_PSF_BELOW = 2.5  # blur, in widths of the PSF, from which on the PSF is fitted


def fit(
    image: np.ndarray | Tensor,
    grid: Grid,
    mesh: Mesh,
    optics: Optics,
    accuracy: float | None = None,
    *,
    settings: FitSettings | None = None,
    counted: np.ndarray | None = None,
    effects: tuple[str, ...] = (),
    resume: str | Path | None = None,
) -> Iterator[FitState]:
    """Fit a mesh to an image; yields a state after every iteration and ends by itself.

    Parameters
    ----------
    image
        (Z, Y, X) measured intensities; NaN marks missing voxels.
    grid
        Where the voxels lie.
    mesh
        Where to start; closed surfaces near the membranes, um.
    optics
        The PSF; held, unless the settings say to fit it.
    accuracy
        Overrides that of the settings.
    settings
        Everything else; see :class:`napari_deltamic.settings.FitSettings`.
    counted
        (Z, Y, X) bool: voxels that may count. Ground that belongs to what no mesh describes should
        be left out, or it pulls.
    effects
        Optional parts of image formation by name.
    resume
        A checkpoint written by :meth:`FitState.save` to go on from.

    Raises
    ------
    InputError
        If the image is not 3D, empty, flat or has no finite voxel, or the mesh lies outside it.
    """
    settings = settings or FitSettings()
    if accuracy is not None:
        settings = settings.model_copy(update={"accuracy": float(accuracy)})
    check_accuracy(settings.accuracy)
    for name in effects:
        if name not in EFFECTS:
            raise InputError(f"unknown effect '{name}': choose from {', '.join(EFFECTS)}")
    pixels, known = check_image(image, grid)
    if counted is not None:
        if counted.shape != grid.shape:
            raise InputError(f"counted has shape {counted.shape}, the image {grid.shape}")
        known = known & (np.asarray(counted) != 0)
    hot = hot_voxels(pixels, known)
    known = known & ~hot
    if known.sum() < FEWEST_VOXELS:
        raise InputError(f"only {known.sum()} voxels count; a fit needs {FEWEST_VOXELS}")
    check_mesh(mesh, grid)
    settings = _completed(settings, pixels, known)
    run = _Run(pixels, known, grid, mesh, optics, settings, effects)
    if resume is not None:
        run.load(load_checkpoint(resume))
    if hot.any():
        run.remark = f"{hot.sum()} hot voxels, brighter than any PSF can make one, are left out"
    return run.states()


def _completed(settings: FitSettings, pixels: np.ndarray, known: np.ndarray) -> FitSettings:
    """The settings with what was left to the software filled in."""
    smoothing, levels = settings.smoothing, settings.levels
    if smoothing is None:
        smoothing = smoothing_for(noise_ratio(pixels, known))
    return settings.model_copy(update={"smoothing": smoothing, "levels": levels or WIDE_LEVELS})


class _Run:
    """The state of a fit between iterations."""

    def __init__(
        self,
        image: np.ndarray,
        counted: np.ndarray,
        grid: Grid,
        mesh: Mesh,
        optics: Optics,
        settings: FitSettings,
        effects: tuple[str, ...],
    ) -> None:
        self.image, self.counted, self.grid = image, counted, grid
        self.settings, self.effects = settings, effects
        self.levels = settings.levels or WIDE_LEVELS
        self.growth = GrowthAlarm(mesh)
        self.mesh = mesh.with_vertices(mesh.vertices_numpy().copy())
        self.optics = optics.detach()
        self.pieces = components(mesh)
        self.adam = AdamUniform(self.pieces, 3)
        self.density = DensityField(mesh, self.pieces, settings.density)
        self.iteration = 0
        self.level_number = 0
        self.step_factor = 1.0
        self.halvings = 0
        self.losses: list[float] = []  # since the level or the present step began
        self.window_start = self.mesh.vertices_numpy()
        self.level_optics = self.optics  # of the blur: a fit of the PSF leaves it alone
        self.bounded = False  # whether the amplitude wanted to be negative
        self.remark = ""  # for the first state
        self.kept: dict[str, np.ndarray] = {}

    # --------------------------------------------------------------------------- iterations

    def states(self) -> Iterator[FitState]:
        levels = self.levels
        first = self.level_number
        for number in range(first, len(levels)):
            if number > first or self.iteration == 0:
                self._enter(number)
            level = Level(
                self.image,
                self.counted,
                self.grid,
                self.level_optics,
                self.settings,
                self.effects,
                levels[number],
            )
            last = number == len(levels) - 1
            if not (level.usable or last):
                continue
            smoother = Preconditioner(self.mesh, level.smoothing)
            while True:
                state = self._iterate(level, smoother)
                finished = self._settled(level, last)
                warning = "" if self.iteration % _WINDOW else self.growth.check(self.mesh)
                over = self.iteration >= self.settings.max_iterations
                if (finished and last) or over:
                    yield self._verdict(state, finished and last, warning)
                    return
                yield replace(state, message="; ".join(filter(None, (self.remark, warning))))
                self.remark = ""
                if finished:
                    break

    def _verdict(self, state: FitState, finished: bool, warning: str) -> FitState:
        """The last state, with what came of the fit in plain words."""
        stuck = self.bounded or state.loss > _EXPLAINS_NOTHING
        if finished and stuck:
            message = (
                f"stuck: {1 - min(state.loss, 1):.0%} of the measured image is explained; "
                "do the seeds lie near bright membranes?"
            )
        elif finished:
            message = "converged"
        else:
            message = f"stopped after {self.iteration} iterations, before it converged"
        message += f"; {warning}" if warning else ""
        return replace(state, converged=finished and not stuck, message=message)

    def _enter(self, number: int) -> None:
        self.level_number = number
        self.level_optics = self.optics
        self.step_factor = 1.0
        self.halvings = 0
        self.losses = []
        self.window_start = self.mesh.vertices_numpy()
        self.adam.restart()
        self.density.restart()

    def _iterate(self, level: Level, smoother: Preconditioner) -> FitState:
        if level.renews:
            self.kept = self._kept()
        kept = self.kept
        vertices = torch.tensor(self.mesh.vertices_numpy(), requires_grad=True)
        with_density = level.factor < self.levels[0] or len(self.levels) == 1
        density = self.density.faces(active=with_density)
        renderer = level.renderer(self.mesh, self.optics)
        otf = renderer.otf(self.optics)
        transform = renderer.transform(vertices, density)
        rendered = level.rendered(renderer, transform, otf)
        voxels = level.voxels(rendered.detach())
        result = match(voxels.of(rendered), voxels.measured, voxels.weights)
        result.loss.backward()
        assert vertices.grad is not None
        gradient = smoother.solve(vertices.grad.numpy())
        step = smoother.solve(self.adam.step(gradient))
        size = self.settings.step * level.width * self.step_factor
        moved = self.mesh.vertices_numpy() - size * step
        if with_density:
            self.density.step(smoother, self.step_factor)
        moved.setflags(write=False)  # states share it
        self.bounded = result.bounded
        loss = float(result.loss.detach())
        if not np.isfinite(loss) or not np.isfinite(moved).all():
            raise FloatingPointError("the fit met a number that is not finite")
        state = self._state(level, result, kept)
        fits_psf = self.settings.fit_psf and level.factor <= _PSF_BELOW
        if fits_psf and len(self.losses) % _PSF_EVERY == _PSF_EVERY - 1:
            self.optics = psf_step(level, renderer, self.optics, transform.detach(), voxels)
        self.mesh = self.mesh.with_vertices(moved)
        self.iteration += 1
        self.losses.append(loss)
        return state

    def _settled(self, level: Level, last: bool) -> bool:
        """Whether the level is done; at the last one the step is halved a few times before."""
        if len(self.losses) % _WINDOW:
            return False
        vertices = self.mesh.vertices_numpy()
        shift = np.sqrt(((vertices - self.window_start) ** 2).sum(1).mean())
        self.window_start = vertices
        if len(self.losses) < 2 * _WINDOW:
            return False
        now, before = np.mean(self.losses[-_WINDOW:]), np.mean(self.losses[-2 * _WINDOW : -_WINDOW])
        gain = 1 - now / before
        tolerance = self.settings.tolerance if last else _COARSE_GAIN
        still = _STILL if last else _COARSE_STILL
        if gain > tolerance and shift > still * level.width * self.step_factor:
            return False
        if not last:
            return True
        self.halvings += 1
        self.step_factor /= 2
        self.losses = []
        return self.halvings > _SETTLE

    # ---------------------------------------------------------------------------- reporting

    def _state(self, level: Level, result: Match, kept: dict[str, np.ndarray]) -> FitState:
        amplitude, background = result.amplitude, result.background
        mesh, optics = self.mesh, self.optics
        density = self.density.faces_numpy()
        grid, accuracy, effects = self.grid, self.settings.accuracy, self.effects

        def rendered() -> np.ndarray:
            with torch.no_grad():
                image = render(
                    mesh,
                    grid,
                    optics,
                    accuracy,
                    density=density,
                    pixel_integration="pixel_integration" in effects,
                )
            return (amplitude * image + background).to(torch.float32).numpy()

        return FitState(
            iteration=self.iteration + 1,
            level=self.level_number + 1,
            levels=len(self.levels),
            mesh=mesh,
            optics=optics,
            density=density,
            loss=float(result.loss.detach()),
            amplitude=amplitude,
            background=background,
            blur=level.factor,
            _render=rendered,
            _checkpoint=lambda: kept,
        )

    def _kept(self) -> dict[str, np.ndarray]:
        return {
            "vertices": self.mesh.vertices_numpy(),
            "faces": self.mesh.faces,
            "optics": self.optics.parameters().numpy(),
            "level_optics": self.level_optics.parameters().numpy(),
            "window_start": self.window_start,
            "levels": np.array(self.levels),
            "iteration": np.array(self.iteration),
            "level": np.array(self.level_number),
            "step_factor": np.array(self.step_factor),
            "halvings": np.array(self.halvings),
            "losses": np.array(self.losses),
            **{f"adam_{k}": np.copy(v) for k, v in self.adam.state().items()},
            **{f"density_{k}": np.copy(v) for k, v in self.density.state().items()},
        }

    def load(self, kept: dict[str, np.ndarray]) -> None:
        """Take over a checkpoint; raises InputError if it belongs to another mesh."""
        if kept["vertices"].shape != self.mesh.vertices.shape or not np.array_equal(
            kept["faces"], self.mesh.faces
        ):
            raise InputError("the checkpoint belongs to another mesh")
        own = self._kept()
        if (
            set(kept) != set(own)
            or any(kept[name].shape != own[name].shape for name in own if name != "losses")
            or not np.array_equal(kept["levels"], own["levels"])
        ):
            raise InputError("the checkpoint belongs to a fit with other settings")
        self.mesh = self.mesh.with_vertices(kept["vertices"])
        self.optics = self.optics.with_parameters(torch.from_numpy(kept["optics"]))
        self.level_optics = self.optics.with_parameters(torch.from_numpy(kept["level_optics"]))
        self.window_start = kept["window_start"]
        self.iteration = int(kept["iteration"])
        self.level_number = int(kept["level"])
        self.step_factor = float(kept["step_factor"])
        self.halvings = int(kept["halvings"])
        self.losses = list(kept["losses"])
        self.adam.load(
            {k.removeprefix("adam_"): v for k, v in kept.items() if k.startswith("adam_")}
        )
        self.density.load(
            {k.removeprefix("density_"): v for k, v in kept.items() if k.startswith("density_")}
        )
