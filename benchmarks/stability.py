"""How stable the numbers are: ``python -m benchmarks.stability`` writes docs/stability.md.

Measures what the tests in tests/stability hold to bars, the paper's scheme on the same triangles
beside it, and draws the picture of gradient error against phase gap.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from unittest import mock

import numpy as np
import torch
from numpy.typing import NDArray

from . import paper_scheme
from .figure import default_data_folder
from .page import put_between

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "stability.md"
PICTURE = ROOT / "docs" / "images" / "stability.png"
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "tests" / "stability")]  # what measures, is tested

import scene_errors as scenes  # noqa: E402
import triangle_errors as triangles  # noqa: E402
import whole_problems as whole  # noqa: E402
from triangle_families import UNITS, families, near_phases, standing  # noqa: E402

Array = NDArray[np.float64]
KINDS = {"float32": torch.float32, "float64": torch.float64}
THRESHOLDS = 10.0 ** np.arange(-8, 0.26, 0.25)
PAPER, BEST = "the paper's switch", "the same, best threshold"


# --------------------------------------------------------------------------- the paper's scheme


@contextmanager
def switching_at(threshold: float | None) -> Iterator[None]:
    """The paper's scheme with another threshold than sqrt(eps); None for its own."""

    def close(phases: list[torch.Tensor]) -> list[torch.Tensor]:
        pairs = [(phases[(p + 1) % 3], phases[(p + 2) % 3]) for p in range(3)]
        return [(a - b).abs() < threshold for a, b in pairs]

    if threshold is None:
        yield
        return
    with mock.patch.object(paper_scheme, "_close", close):
        yield


@cache
def _exact(name: str, single: bool) -> tuple[Array, Array]:
    vertices, xi = families()[name]
    return triangles.exact(triangles.rounded(vertices, single), xi)


def paper_errors(vertices: Array, xi: Array, exact: tuple[Array, Array], kind: str) -> Array:
    """(2, N): errors of value and gradient of the paper's scheme, judged as ours are."""
    n, dtype = len(vertices), KINDS[kind]
    v = torch.from_numpy(vertices.reshape(-1, 3))
    f = torch.arange(3 * n).reshape(n, 3)
    k = torch.tensor(np.asarray([xi], float))
    value = np.array(
        [paper_scheme.transform(v, f[i : i + 1], k, 1, dtype).item() for i in range(n)]
    )
    real, imaginary = (
        paper_scheme.gradient(v, f, k, torch.tensor([g], dtype=torch.complex128), 1, dtype)
        for g in (1, 1j)
    )
    gradient = (real + 1j * imaginary).numpy().reshape(n, 3, 3)
    area, per_gradient = triangles.scales(vertices, xi)
    allowance = np.maximum(1, triangles.uncertainty(vertices, xi) / triangles.BAR[kind])
    errors = [
        np.abs(value - exact[0]) / area,
        np.abs(gradient - exact[1]).max((1, 2)) / per_gradient,
    ]
    # What is no number is as wrong as can be.
    return np.where(np.isfinite(errors), errors, np.inf) / allowance


def paper_family(name: str, kind: str) -> tuple[float, float]:
    """Worst errors of a family: value, gradient."""
    vertices, xi = families()[name]
    single = kind == "float32"
    kept = triangles.rounded(vertices, single)
    value, gradient = paper_errors(kept, np.asarray(xi), _exact(name, single), kind).max(1)
    return float(value), float(gradient)


@cache
def best_threshold(kind: str) -> float:
    """The threshold whose worst gradient over the families is least (phases up to 1e3 rad)."""
    near = [name for name in families() if not name.startswith(("far", "slivers", *UNITS))]

    def worst(threshold: float) -> float:
        with switching_at(threshold):
            return max(paper_family(name, kind)[1] for name in near)

    return min((float(t) for t in THRESHOLDS), key=worst)


# -------------------------------------------------------------------------------------- tables


def table(headings: Sequence[str], rows: list[Sequence[str]]) -> str:
    """Markdown, the first column to the left."""
    rule = ["---", *["---:"] * (len(headings) - 1)]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (headings, rule, *rows))


def number(x: float) -> str:
    """Two digits."""
    return "no number" if not np.isfinite(x) else f"{x:.1e}"


def implementations() -> str:
    """Worst errors over all families, the paper's scheme first."""
    rows: list[Sequence[str]] = []
    for name, of in ((PAPER, lambda kind: None), (BEST, best_threshold)):
        cells, notes = [], []
        for kind in KINDS:
            threshold = of(kind)
            with switching_at(threshold):
                found = np.array([paper_family(family, kind) for family in families()])
            # Units that are beyond float32 are not held against it here.
            cells += [number(x) for x in found[np.isfinite(found).all(1)].max(0)]
            notes.append("" if threshold is None else f"{threshold:.0e}")
        label = f"{name} ({' and '.join(notes)} rad)" if notes[0] else name
        rows.append([label, *cells])
    worst = triangles.worst_errors()
    for loop, told in (("list", "any wavevectors"), ("band", "a band")):
        for level in [*triangles.LEVELS, "torch"]:
            cells = [
                number(worst[f"{loop}, {level}, {kind}"][q])
                for kind in KINDS
                for q in ("value", "gradient")
            ]
            rows.append([f"closed form, {told}, {level}", *cells])
    heads = [f"{kind} {q}" for kind in KINDS for q in ("value", "gradient")]
    return table(["implementation", *heads], rows)


def by_family() -> str:
    """Worst errors of each family: the paper's scheme, and the worst of all our loops."""
    rows: list[Sequence[str]] = []
    for name, (vertices, xi) in families().items():
        cells = []
        for kind in KINDS:
            theirs = paper_family(name, kind)
            with switching_at(best_threshold(kind)):
                best = paper_family(name, kind)
            ours = [triangles.errors(*path, kind == "float32")[name] for path in triangles.PATHS]
            cells += [number(theirs[1]), number(best[1])]
            cells += [number(max(e[q] for e in ours)) for q in ("gradient", "value")]
        limit = triangles.uncertainty(vertices, np.asarray(xi)).max()
        cells.append(number(limit) if limit > triangles.BAR["float64"] else "")
        rows.append([f"{name} ({len(vertices)})", *cells])
    columns = ("paper, gradient", "best threshold, gradient", "**ours, gradient**", "ours, value")
    heads = [f"{short} {what}" for short in ("f32", "f64") for what in columns]
    return table(["family (triangles)", *heads, "left open by f64 coordinates"], rows)


def hard_scenes() -> str:
    """Errors of image and gradient of the particle-mesh, over the accuracy asked for."""
    rows: list[Sequence[str]] = []
    for name in scenes.scenes():
        cells = []
        for accuracy in scenes.ACCURACIES:
            image, gradient = scenes.scene_errors(name, accuracy)
            cells.append(f"{image:.1e} / {gradient:.1e}")
        rows.append([name, *cells])
    return table(["scene", *(f"asked {a:.0e}" for a in scenes.ACCURACIES)], rows)


# ------------------------------------------------------------------------------ whole problems


def whole_gradients() -> str:
    """Gradients of the loss against finite differences."""
    rows: list[Sequence[str]] = []
    for method, accuracy in (("closed form", 0.0), ("closed form", 1e-6), ("particle-mesh", 1e-9)):
        for likelihood in ("poisson", "gaussian", "paper"):
            found = whole.gradient_errors(method, accuracy, likelihood)
            rows.append(
                [f"{method}, accuracy {accuracy:g}, {likelihood}", *map(number, found.values())]
            )
    return table(["gradient of the loss in", "vertices", "PSF", "densities"], rows)


def long_fits(iterations: int) -> str:
    """Fits to noise."""
    rows: list[Sequence[str]] = []
    for ends, seed in ((True, 0), (True, 1), (False, 0)):
        found = whole.fit_to_noise(iterations, ends, seed)
        rows.append(
            [
                f"{'ends by itself' if ends else 'never ends'}, noise {seed}",
                str(found.iterations),
                "yes" if found.finite else "NO",
                f"x{found.area:.2f}",
                f"x{found.volume:.2f}",
                f"{found.moved_late:.1e} um",
                f"x{found.grown_late:.4f}",
                f"{found.grown_mb:.1f} MB",
            ]
        )
    heads = ["", "iterations", "finite", "area", "volume"]
    late = ["centre, late", "area, late", "memory, late"]
    return table(["fit to noise", *heads[1:], *late], rows)


def hard_meshes(data: Path) -> str:
    """Every file of the folder."""
    folder = data / "meshes_hard"
    if not folder.is_dir():
        return f"not measured: no {folder.name} (set DELTAMIC_DATA)"
    rows: list[Sequence[str]] = []
    for path in sorted(folder.iterdir()):
        found = whole.fit_hard_mesh(path)
        if found.refused:
            rows.append([path.name, f"refused: {found.refused}", "", "", ""])
            continue
        state = f"{found.faces} faces, {'closed' if found.closed else 'open'}"
        losses = f"{found.first_loss:.3f} to {found.last_loss:.4f}"
        finite = "yes" if found.finite else "NO"
        rows.append([path.name, state, str(found.repairs), finite, losses])
    return table(["file", "", "repairs told", "finite, 50 iterations", "loss"], rows)


def threads_and_units() -> str:
    """Fits that should end alike."""
    rows: list[Sequence[str]] = []
    for name, settings in whole.THREADED.items():
        apart, one, two = whole.apart_by_threads(settings)
        rows.append([f"1 and 2 threads, {name}", f"{one}, {two}", number(apart)])
    for name, unit in (("nm", 1e3), ("m", 1e-6)):
        apart = whole.apart_by_units(unit)
        rows.append([f"um and {name}", "40, 40", number(apart)])
    return table(["two fits", "iterations", "largest distance of a vertex / size"], rows)


# ----------------------------------------------------------------------------------- the picture


def gradient_against_gap() -> tuple[Array, dict[str, Array]]:
    """Gaps, and the worst gradient error of each scheme at each of them."""
    gaps = 10.0 ** np.arange(-12, 2.01, 0.25)
    curves: dict[str, list[float]] = {}
    xi, rng = np.array([0.0, 0.0, 1.0]), np.random.default_rng(11)
    for gap in gaps:
        phases = np.concatenate([p for p in near_phases(gap).values() if p])
        vertices = standing(np.tile(phases, (2, 1)), rng)
        for kind in KINDS:
            single = kind == "float32"
            kept = triangles.rounded(vertices, single)
            exact = triangles.exact(kept, xi)
            for name, threshold in ((PAPER, None), (BEST, best_threshold(kind))):
                with switching_at(threshold):
                    worst = float(paper_errors(kept, xi, exact, kind)[1].max())
                curves.setdefault(f"{name}, {kind}", []).append(worst)
            ours = triangles.errors_of_each("list", vertices, tuple(xi), single)["gradient"]
            curves.setdefault(f"this software, {kind}", []).append(float(ours.max()))
    return gaps, {name: np.array(curve) for name, curve in curves.items()}


def draw(path: Path) -> None:
    """Gradient error against phase gap."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    gaps, curves = gradient_against_gap()
    colours = {PAPER: "tab:red", BEST: "tab:orange", "this software": "tab:blue"}
    figure, axes = plt.subplots(figsize=(7.5, 4.6), layout="constrained")
    for name, curve in curves.items():
        scheme, kind = name.rsplit(", ", 1)
        style = "-" if kind == "float64" else "--"
        axes.loglog(gaps, curve, style, color=colours[scheme], label=name, lw=1.6)
    axes.axhline(1, color="0.7", lw=0.8)
    axes.annotate("nothing of it is right", (1.2, 1.6), color="0.45", fontsize=8)
    axes.set_xlabel("gap between the nearest phases of a triangle (rad)")
    axes.set_ylabel("worst relative error of the vertex gradient")
    axes.legend(fontsize=8, ncols=2, loc="upper center", bbox_to_anchor=(0.5, 1.2), frameon=False)
    figure.savefig(path, dpi=130)
    plt.close(figure)


# ------------------------------------------------------------------------------------------ page


def main(argv: Sequence[str]) -> int:
    """Measures and writes; 0."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.stability", description=__doc__)
    parser.add_argument("--data", type=Path, default=default_data_folder())
    parser.add_argument("--page", type=Path, default=PAGE)
    parser.add_argument("--picture", type=Path, default=PICTURE)
    parser.add_argument("--quick", action="store_true", help="1000 iterations in place of 10,000")
    parts: dict[str, Callable[[], str]] = {
        "implementations": implementations,
        "families": by_family,
        "scenes": hard_scenes,
        "gradients": whole_gradients,
        "threads": threads_and_units,
        "meshes": lambda: hard_meshes(chosen.data),
        "noise": lambda: long_fits(1000 if chosen.quick else 10_000),
    }
    parser.add_argument("--only", nargs="+", choices=[*parts, "picture"], default=None)
    chosen = parser.parse_args(argv)
    names = chosen.only or ["picture", *parts]
    for name in names:
        print(f"{name} ...", file=sys.stderr, flush=True)
        if name == "picture":
            draw(chosen.picture)
        else:
            put_between(chosen.page, name, parts[name]())
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
