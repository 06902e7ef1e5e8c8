"""What accuracy costs in time: every way to render a scene, timed and compared with the exact."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from statistics import median
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from ..common.accuracy_bounds import check_accuracy
from ..common.choices import RENDERED_ACCURACY
from ..common.words import duration
from ..errors import InputError
from ..fourier.cost import Costs
from ..fourier.fixed_plan import fixed_plan
from ..fourier.plan import Method
from ..fourier.quadrature import DEGREES
from ..geometry.mesh import Mesh
from ..optics import Optics
from ..scene import Renderer, Scene
from ..scene.formation import padded_shape
from ..scene.grid import Grid
from ..scene.memory import Peak
from .machine_costs import costs as known_costs

# What is compared: |OTF| at the edge of a band, and accuracies asked of the planner; together they
# cover all that anybody would use.
THRESHOLDS = (1e-1, 1e-2, 1e-3, 1e-4)
PLANNED = (1e-1, 3e-2, 1e-2, 3e-3, 1e-3, 1e-4, 1e-5, 1e-6)
_RULE_THRESHOLD = 1e-4  # of the band on which rules are compared: its own error is hardly seen
_FINEST = 1e-9  # accuracy of the reference if the exact one takes too long
_VISIBLE = 1e-4  # of a mesh's area: an image that shows less shows only the rim of its PSF
_REPEATS, _ENOUGH = 3, 1.0  # runs of a timing; s above which one run is enough

Device = Literal["cpu", "cuda"]


@dataclass(frozen=True)
class Way:
    """One way to render a scene, and its measured cost.

    Attributes
    ----------
    method, precision, device
        ``"closed form"`` or ``"particle-mesh"``; ``"float32"`` or ``"float64"``; ``"cpu"``.
    band
        The edge of the band as |OTF|; 0 is the full grid.
    rule
        Degree of the quadrature rule on a face, or several; "" for the closed form.
    accuracy
        The accuracy asked of the planner; None for a way put together by hand.
    expected
        Time with the gradient by the cost model, s.
    forward, gradient
        Median time of the image, and of the image with its gradient, s; None if not measured.
    memory
        Peak memory of the process beyond what it held before, bytes; None where the system does not
        tell it.
    error, gradient_error
        L2 error, relative to the reference, of the image, and of the gradient by the vertices with
        white noise as incoming gradient; None if not measured.
    in_use, on_front, reference
        Whether the scene would be rendered this way; whether no measured way is both faster and
        more accurate; whether the others were compared with it.
    note
        Why it was not measured.
    """

    method: Method
    band: float
    rule: str
    precision: Literal["float32", "float64"]
    accuracy: float | None = None
    device: Device = "cpu"
    expected: float = 0.0
    forward: float | None = None
    gradient: float | None = None
    memory: int | None = None
    error: float | None = None
    gradient_error: float | None = None
    in_use: bool = False
    on_front: bool = False
    reference: bool = False
    note: str = ""

    @property
    def measured(self) -> bool:
        """Whether it has both a time and an error."""
        return self.gradient is not None and self.error is not None

    @property
    def name(self) -> str:
        """Method, band, rule and precision in words."""
        band = "full grid" if self.band == 0 else f"|OTF| > {self.band:.0e}"
        parts = [self.method, band, self.rule, self.precision]
        return ", ".join(part for part in parts if part)


@dataclass(frozen=True)
class _Candidate:
    way: Way
    renderer: Renderer


def measure_ways(
    mesh: Mesh,
    grid: Grid,
    optics: Optics,
    accuracy_in_use: float = RENDERED_ACCURACY,
    *,
    by_hand: bool = True,
    budget: float = 10.0,
    costs: Costs | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Iterator[Way]:
    """Time every way to render a scene, one after the other; the reference comes first.

    Parameters
    ----------
    mesh, grid, optics
        The scene.
    accuracy_in_use
        The accuracy with which it is rendered; that way is marked.
    by_hand
        Whether ways that the planner does not choose are timed as well.
    budget
        A way that would take longer than this with its gradient, s, is listed with its expected
        time but not measured.
    costs
        Costs of this machine; by default those kept, or the built-in ones.
    progress
        Called with how many ways are done, and how many there are.

    Raises
    ------
    InputError
        If the accuracy is not in [0, 1), or the mesh not in the units of the grid.
    """
    check_accuracy(accuracy_in_use)
    costs = costs or known_costs()
    scene = Scene.of(mesh, optics)
    candidates = _candidates(scene, mesh, grid, accuracy_in_use, costs, by_hand)
    exact = candidates[0]
    if exact.way.expected > budget:
        reference = _planned(scene, grid, _FINEST, costs, "particle-mesh")
        candidates = [reference, *candidates]
    else:
        reference = exact
    # The incoming gradient: the same noise for all ways.
    generator = torch.Generator().manual_seed(0)
    incoming = torch.randn(grid.shape, generator=generator, dtype=torch.float64)
    known: tuple[Tensor, Tensor] | None = None
    for done, candidate in enumerate(candidates):
        way = candidate.way
        is_reference = candidate is reference
        if way.expected > budget and not is_reference:
            way = replace(way, note=f"not measured: about {duration(way.expected)}")
        else:
            try:
                way, result = _measured(candidate, mesh, incoming)
            except (MemoryError, RuntimeError) as error:
                if is_reference:
                    raise
                way = replace(way, note=f"not measured: {_reason(error)}")
            else:
                if known is None:
                    check_visible(float(result[0].sum()), mesh)
                    known = result
                way = replace(
                    way,
                    error=_relative(result[0], known[0]),
                    gradient_error=_relative(result[1], known[1]),
                    reference=is_reference,
                )
        if progress is not None:
            progress(done + 1, len(candidates))
        yield way


def with_front(ways: Iterable[Way]) -> list[Way]:
    """The ways, with those marked that no other beats in both time (with gradient) and error.

    The reference is never marked: it has no error to compare.
    """
    ways = list(ways)
    points = [(w.gradient, w.error) if w.measured and not w.reference else None for w in ways]

    def on_front(point: tuple[float | None, float | None] | None) -> bool:
        if point is None:
            return False
        others = np.array([p for p in points if p is not None], dtype=float)
        own = np.array(point, dtype=float)
        beats = (others <= own).all(1) & (others < own).any(1)
        return not beats.any()

    return [replace(w, on_front=on_front(p)) for w, p in zip(ways, points, strict=True)]


# ------------------------------------------------------------------------------------ the ways


def _planned(
    scene: Scene, grid: Grid, accuracy: float, costs: Costs, method: Method | None = None
) -> _Candidate:
    """The way that the planner chooses for an accuracy."""
    renderer = Renderer(scene, grid, accuracy, method=method)
    degrees = sorted({r.degree for r, _ in renderer.plan.rules})
    named = f"degree {'/'.join(map(str, degrees))}" if degrees else ""
    return _candidate(renderer, named, costs, accuracy)


def _by_hand(
    scene: Scene,
    mesh: Mesh,
    grid: Grid,
    threshold: float,
    degree: int | None,
    single: bool,
    costs: Costs,
) -> _Candidate:
    """The closed form (no degree), or one rule on every face, on a band (0: the full grid)."""
    accuracy, optics = min(threshold, _RULE_THRESHOLD), scene.optics
    places = mesh.vertices_numpy()
    z, y, x = (float(w) for w in optics.width())
    plan = fixed_plan(
        places - np.asarray(grid.origin),
        mesh.faces,
        padded_shape(places, grid, np.asarray(optics.reach(accuracy))),
        grid.voxel_size,
        (z, y, x),
        threshold,
        degree,
        single,
        optics.diagonal,
        optics.otf,
    )
    renderer = Renderer(scene, grid, accuracy, plan=plan)
    return _candidate(renderer, f"degree {degree}" if degree else "", costs, None)


def _candidate(
    renderer: Renderer, rule_name: str, costs: Costs, accuracy: float | None
) -> _Candidate:
    plan = renderer.plan
    way = Way(
        method=plan.method,
        band=plan.threshold,
        rule=rule_name,
        precision="float32" if plan.single else "float64",
        accuracy=accuracy,
        expected=costs.seconds(plan.work, plan.single),
    )
    return _Candidate(way, renderer)


def _candidates(
    scene: Scene, mesh: Mesh, grid: Grid, accuracy_in_use: float, costs: Costs, by_hand: bool
) -> list[_Candidate]:
    """All ways, the exact one first."""
    made = partial(_by_hand, scene, mesh, grid, costs=costs)
    found = [made(0.0, None, False)]
    if by_hand:
        found += [made(0.0, None, True)]
        found += [made(t, None, single) for t in reversed(THRESHOLDS) for single in (False, True)]
        found += [
            made(_RULE_THRESHOLD, degree, single) for degree in DEGREES for single in (True, False)
        ]
    asked = sorted({*PLANNED, *([accuracy_in_use] if accuracy_in_use > 0 else [])}, reverse=True)
    found += [_planned(scene, grid, accuracy, costs) for accuracy in asked]
    used = 0 if accuracy_in_use == 0 else len(found) - len(asked) + asked.index(accuracy_in_use)
    found[used] = replace(found[used], way=replace(found[used].way, in_use=True))
    return found


def _measured(
    candidate: _Candidate, mesh: Mesh, incoming: Tensor
) -> tuple[Way, tuple[Tensor, Tensor]]:
    """The way with times and memory, and its image and gradient in double precision."""
    renderer = candidate.renderer
    v = torch.tensor(mesh.vertices_numpy(), requires_grad=True)
    incoming = incoming.to(torch.float32 if renderer.plan.single else torch.float64)

    def forward() -> Tensor:
        return renderer.image(renderer.transform(v), renderer.otf(renderer.scene.optics))

    forwards, boths = [], []
    with Peak() as peak:  # of the first run, which prepares what later ones reuse
        image, gradient, *first = _timed(forward, v, incoming)
    slow = first[1] > _ENOUGH
    for _ in range(0 if slow else _REPEATS):
        _, _, one, both = _timed(forward, v, incoming)
        forwards.append(one)
        boths.append(both)
    way = replace(
        candidate.way,
        forward=first[0] if slow else median(forwards),
        gradient=first[1] if slow else median(boths),
        memory=peak.bytes,
    )
    return way, (image.detach().to(torch.float64), gradient.to(torch.float64))


def _timed(
    forward: Callable[[], Tensor], v: Tensor, incoming: Tensor
) -> tuple[Tensor, Tensor, float, float]:
    start = time.perf_counter()
    image = forward()
    middle = time.perf_counter()
    (gradient,) = torch.autograd.grad(image, v, incoming)
    return image, gradient, middle - start, time.perf_counter() - start


def _relative(found: Tensor, exact: Tensor) -> float:
    return float((found - exact).norm()) / max(float(exact.norm()), 1e-300)


def check_visible(total: float, mesh: Mesh) -> None:
    """Raise InputError unless the sum of an image is a visible share of the mesh's area."""
    if not total > _VISIBLE * float(mesh.areas() @ mesh.membranes()):
        raise InputError("the image of the mesh is empty: does it lie inside the grid?")


def _reason(error: BaseException) -> str:
    text = " ".join(str(error).split())
    return "not enough memory" if isinstance(error, MemoryError) or "alloc" in text else text[:80]
