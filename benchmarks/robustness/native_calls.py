"""A child of the experiment with native functions: makes wrong calls, and says what became of them.

A line each: number, ``begun``, ``refused``, ``done`` or ``wrong``, and what was called.
"""

from __future__ import annotations

import faulthandler
import importlib
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from .sanitized import MODULES, load

Random = np.random.Generator
Call = tuple[Callable[..., Any], list[Any]]
_MARGIN = 64  # numbers before and behind an array that is written to
_MARK = {"f": -7.25, "i": -77, "u": 77}


class Calls:
    """Valid calls of every function, with arguments of a random size."""

    def __init__(self, fourier: ModuleType, remeshing: ModuleType, watched: bool) -> None:
        self.fourier, self.remeshing, self.watched = fourier, remeshing, watched
        self.written: list[np.ndarray] = []  # whole arrays, of which calls get the middle
        self.makers = [
            self.remesh, self.crossings, self.near_faces, self.bending, self.region_pieces,
            self.guard, self.limit, self.band_forward, self.band_backward, self.list_forward,
            self.list_backward, self.quadrature, self.spread, self.gather, self.pull,
            self.to_real, self.to_box,
        ]  # fmt: skip

    def out(self, *shape: int, kind: Any = np.float64) -> np.ndarray:
        """An array to write to."""
        if not self.watched:  # the sanitizer sees its borders only if there is nothing around it
            return np.zeros(shape, kind)
        size = int(np.prod(shape))
        whole = np.full(size + 2 * _MARGIN, _MARK[np.dtype(kind).kind], kind)
        whole[_MARGIN : _MARGIN + size] = 0
        self.written.append(whole)
        return whole[_MARGIN : _MARGIN + size].reshape(shape)

    def untouched(self) -> bool:
        """Whether nothing was written beside the arrays."""
        return all(
            (w[:_MARGIN] == _MARK[w.dtype.kind]).all()
            and (w[-_MARGIN:] == _MARK[w.dtype.kind]).all()
            for w in self.written
        )

    @staticmethod
    def mesh(random: Random) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Vertices, faces and regions: a bipyramid, or triangles at random."""
        n = int(random.integers(3, 9))
        if random.random() < 0.6:
            turn = 2 * np.pi * np.arange(n) / n
            ring = np.column_stack([np.zeros(n), np.sin(turn), np.cos(turn)])
            vertices = np.concatenate([ring, [[1.0, 0, 0], [-1.0, 0, 0]]])
            after = (np.arange(n) + 1) % n
            top = np.column_stack([np.arange(n), after, np.full(n, n)])
            faces = np.concatenate([top, np.column_stack([after, np.arange(n), np.full(n, n + 1)])])
        else:
            vertices = random.normal(size=(n + 2, 3))
            faces = np.array([random.permutation(n + 2)[:3] for _ in range(2 * n)])
        regions = np.tile([1, 0], (len(faces), 1))
        regions[: len(faces) // 3] = [int(random.choice([2, 3, 2**31, 2**33 + 1])), 0]
        return vertices, faces.astype(np.int64), regions.astype(np.int64)

    def remesh(self, random: Random) -> Call:
        v, f, r = self.mesh(random)
        n = len(v)
        guard = random.integers(0, 3, n).astype(np.uint8)
        fixed = random.integers(0, 3, n).astype(np.uint8)
        length = np.full(n, random.uniform(0.2, 2))
        carried = random.normal(size=(n, int(random.integers(0, 3))))
        apart = float(random.choice([0.0, 1e-6]))
        return self.remeshing.remesh, [v, f, r, length, fixed, carried, guard, 2, True, apart]

    def crossings(self, random: Random) -> Call:
        v, f, _ = self.mesh(random)
        return self.remeshing.crossings, [v, np.ascontiguousarray(f[:, :2]), f, 0.1]

    def near_faces(self, random: Random) -> Call:
        v, f, _ = self.mesh(random)
        return self.remeshing.near_faces, [random.normal(size=(5, 3)), v, f, 0.5]

    def bending(self, random: Random) -> Call:
        v, f, _ = self.mesh(random)
        walls = int(random.integers(0, 3))
        wall, side = random.integers(-1, max(walls, 1), len(v)), np.ones(len(f))
        return self.remeshing.bending, [v, f, np.ones(len(v)), wall, side, walls, 0.1]

    def region_pieces(self, random: Random) -> Call:
        _, f, r = self.mesh(random)
        return self.remeshing.region_pieces, [f, r, int(f.max()) + 1]

    def _guard(self, random: Random) -> tuple[np.ndarray, list[Any]]:
        v, f, _ = self.mesh(random)
        walls = int(random.integers(0, 3))
        wall = random.integers(0, max(walls, 1), len(f))
        pairs = np.ones(walls * walls, np.uint8)
        edges = np.ascontiguousarray(f[:, :2])
        return v, [edges, f, np.full(len(v), 0.3), 1e-3, 1e-9, wall, pairs]

    def guard(self, random: Random) -> Call:
        v, given = self._guard(random)

        def call(*arguments: Any) -> Any:
            return self.remeshing.Guard(*arguments).limit(v, v + 0.1)

        return call, given

    def limit(self, random: Random) -> Call:
        v, given = self._guard(random)
        guard = self.remeshing.Guard(*given)
        return guard.limit, [v, v + random.normal(size=v.shape)]

    def _triangles(self, random: Random) -> list[Any]:
        v, f, _ = self.mesh(random)
        return [v, f, np.ones(len(f))]

    @staticmethod
    def _kind(random: Random) -> tuple[str, Any]:
        return ("f32", np.float32) if random.random() < 0.5 else ("f64", np.float64)

    def _end(self, random: Random) -> list[Any]:
        return [int(random.integers(1, 4)), str(random.choice(self.fourier.simd_levels()))]

    @staticmethod
    def _rows(random: Random) -> tuple[np.ndarray, np.ndarray]:
        count = int(random.integers(1, 9))
        rows = random.integers(-4, 5, (count, 3)).astype(np.int32)
        rows[:, 2] = random.integers(1, 9, count)
        return rows, np.concatenate([[0], np.cumsum(rows[:-1, 2])]).astype(np.int64)

    def band_forward(self, random: Random) -> Call:
        suffix, kind = self._kind(random)
        rows, offset = self._rows(random)
        out = self.out(int(rows[:, 2].sum()), 2, kind=kind)
        given = [*self._triangles(random), rows, offset, [1.0, 1.0, 1.0], out]
        return getattr(self.fourier, f"band_forward_{suffix}"), [*given, *self._end(random)]

    def band_backward(self, random: Random) -> Call:
        suffix, kind = self._kind(random)
        rows, offset = self._rows(random)
        mesh = self._triangles(random)
        grad = np.ones((int(rows[:, 2].sum()), 2), kind)
        results = [self.out(*mesh[0].shape), self.out(len(mesh[1]))]
        given = [*mesh, rows, offset, [1.0, 1.0, 1.0], grad, *results]
        return getattr(self.fourier, f"band_backward_{suffix}"), [*given, *self._end(random)]

    def list_forward(self, random: Random) -> Call:
        suffix, kind = self._kind(random)
        xi = random.normal(size=(7, 3))
        given = [*self._triangles(random), xi, self.out(7, 2, kind=kind)]
        return getattr(self.fourier, f"list_forward_{suffix}"), [*given, *self._end(random)]

    def list_backward(self, random: Random) -> Call:
        suffix, kind = self._kind(random)
        mesh = self._triangles(random)
        results = [self.out(*mesh[0].shape), self.out(len(mesh[1]))]
        given = [*mesh, random.normal(size=(7, 3)), np.ones((7, 2), kind), *results]
        return getattr(self.fourier, f"list_backward_{suffix}"), [*given, *self._end(random)]

    @staticmethod
    def _rules(elements: int, corners: int) -> list[Any]:
        rule = np.arange(elements, dtype=np.int32) % 2
        places = np.full((4, corners), 1 / corners)
        return [rule, np.array([0, 1, 4], np.int64), places, np.full(4, 0.25)]

    def quadrature(self, random: Random) -> Call:
        shape, scale, kernels, row = self._grid(random)
        suffix, kind = self._kind(random)
        mesh = self._triangles(random)
        out = self.out(*shape[:2], row, kind=kind)

        def call(*rules: Any) -> Any:
            points = self.fourier.Quadrature(*rules)
            spread = getattr(self.fourier, f"spread_{suffix}")
            return spread(*mesh, points, shape, scale, kernels, None, out, 2, "generic")

        return call, self._rules(len(mesh[1]), 3)

    @staticmethod
    def _grid(random: Random) -> tuple[list[int], list[float], list[np.ndarray], int]:
        width = int(random.integers(2, 9))
        lanes = 4 if width <= 4 else 8
        shape = [int(n) for n in random.integers(width, width + 12, 3)]
        kernels = [random.normal(size=(5, width)) for _ in range(3)]
        return shape, [2.0, 2.0, 2.0], kernels, shape[2] + lanes

    def _meshed(self, random: Random) -> tuple[list[Any], list[Any], list[int], int]:
        shape, scale, kernels, row = self._grid(random)
        mesh = self._triangles(random)
        points = self.fourier.Quadrature(*self._rules(len(mesh[1]), 3))
        return mesh, [points, shape, scale, kernels], shape, row

    def spread(self, random: Random) -> Call:
        suffix, kind = self._kind(random)
        mesh, grid, shape, row = self._meshed(random)
        vectors = None if random.integers(2) else np.ones((len(mesh[1]), 3))
        given = [*mesh, *grid, vectors, self.out(*shape[:2], row, kind=kind)]
        return getattr(self.fourier, f"spread_{suffix}"), [*given, *self._end(random)]

    def gather(self, random: Random) -> Call:
        suffix, kind = self._kind(random)
        mesh, grid, shape, row = self._meshed(random)
        field = self.out(*shape[:2], row, kind=kind)
        given = [*mesh, *grid, field, self.out(*mesh[1].shape)]
        return getattr(self.fourier, f"gather_{suffix}"), [*given, *self._end(random)]

    def pull(self, random: Random) -> Call:
        suffix, kind = self._kind(random)
        mesh, grid, shape, row = self._meshed(random)
        field = self.out(*shape[:2], row, kind=kind)
        given = [*mesh, *grid, field, self.out(*mesh[0].shape), self.out(len(mesh[1]))]
        return getattr(self.fourier, f"pull_{suffix}"), [*given, *self._end(random)]

    def _spectrum(self, random: Random) -> list[Any]:
        _, kind = self._kind(random)
        shape = [int(n) for n in random.integers(4, 15, 3)]
        half = [int(random.integers(0, n // 2 + 1)) for n in shape]
        count = [int(random.integers(1, n + 1)) for n in shape]
        box = self.out(2 * half[0] + 1, 2 * half[1] + 1, half[2] + 1, 2, kind=kind)
        real = self.out(count[0], count[1], count[2] + 3, kind=kind)
        weights = None if random.random() < 0.5 else np.ones(box.shape[:3], kind)
        yx = np.ones((2 * half[1] + 1, half[2] + 1), kind)
        factors = [np.ones(2 * half[0] + 1, kind), yx]
        return [box, real, shape, half, count, *factors, weights, *self._end(random)]

    def to_real(self, random: Random) -> Call:
        given = self._spectrum(random)
        suffix = "f32" if given[0].dtype == np.float32 else "f64"
        return getattr(self.fourier, f"to_real_{suffix}"), given

    def to_box(self, random: Random) -> Call:
        given = self._spectrum(random)
        suffix = "f32" if given[0].dtype == np.float32 else "f64"
        return getattr(self.fourier, f"to_box_{suffix}"), given


# ---- spoiling ------------------------------------------------------------------------------------

_FLOATS = [np.nan, np.inf, -np.inf, 1e308, -1e308, 1e300, 1e155, 5e-324, 0.0, -1.0, 1e12, 1e18]
_INTEGERS = [
    -1,
    0,
    1,
    7,
    10**4,
    2**20,
    2**31 - 1,
    2**31,
    2**32,
    2**40,
    2**63 - 1,
    -(2**31),
    -(2**63),
]


def spoilt(value: Any, random: Random) -> Any:
    """Something else than an argument was."""
    if isinstance(value, np.ndarray):
        return _other_array(value, random)
    if isinstance(value, list) and value and isinstance(value[0], np.ndarray):
        found = list(value)
        found[int(random.integers(len(found)))] = _other_array(found[0], random)
        return found if random.random() < 0.8 else found[1:]
    if isinstance(value, list):
        found = list(value)
        kind = int(random.integers(4))
        if kind == 0:
            return found[1:]
        if kind == 1:
            return [*found, 1]
        found[int(random.integers(len(found)))] = spoilt(found[0], random)
        return found
    if isinstance(value, bool):
        return [2, None, "yes"][int(random.integers(3))]
    if isinstance(value, int):
        return [*_INTEGERS, 1.5, None, "3"][int(random.integers(len(_INTEGERS) + 3))]
    if isinstance(value, float):
        return [*_FLOATS, None, "x"][int(random.integers(len(_FLOATS) + 2))]
    if isinstance(value, str):
        return ["", "avx9000", "\0", None, 3][int(random.integers(5))]
    return [None, 3, np.zeros(3)][int(random.integers(3))]


def _other_array(a: np.ndarray, random: Random) -> Any:
    kind = int(random.integers(10))
    if kind < 4 and a.size:  # other numbers
        found = a.copy()
        flat = found.reshape(-1)
        at = int(random.integers(a.size)) if random.random() < 0.7 else slice(None)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            if a.dtype.kind == "f":
                flat[at] = np.float64(_FLOATS[int(random.integers(len(_FLOATS)))]).astype(a.dtype)
            elif random.random() < 0.3 and a.ndim == 2:
                found[int(random.integers(len(a)))] = a.reshape(-1)[0]  # the same corner thrice
            else:
                flat[at] = np.int64(_INTEGERS[int(random.integers(len(_INTEGERS)))]).astype(a.dtype)
        return found
    if kind < 8:  # another shape
        shapes: list[Callable[[], Any]] = [
            lambda: a.reshape(-1).copy(),
            lambda: a[None].copy(),
            lambda: a[:-1].copy(),
            lambda: np.concatenate([a, a[:1]]) if a.ndim else a,
            lambda: a[:0].copy(),
            lambda: np.ascontiguousarray(a[..., :-1]),
            lambda: np.concatenate([a, a], axis=-1) if a.ndim else a,
            lambda: np.zeros((), a.dtype),
            lambda: np.asfortranarray(a),
            lambda: a[::-1],
            lambda: a.repeat(3, axis=0)[::3],
            lambda: np.zeros((0, 0, 0, 0), a.dtype),
        ]
        return shapes[int(random.integers(len(shapes)))]()
    types: list[Any] = [
        np.float32,
        np.float64,
        np.int32,
        np.int64,
        np.uint8,
        np.complex128,
        bool,
        object,
        ">f8",
    ]
    if kind == 8:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return a.astype(types[int(random.integers(len(types)))])
    others: list[Any] = [None, "array", 3, a.tolist(), [a]]
    return others[int(random.integers(len(others)))]


def main(seed: int, first: int, stop: int, seconds: float, folder: str) -> None:
    """Make the calls of these numbers."""
    faulthandler.enable()
    if folder:
        modules = [load(name, Path(folder)) for name in MODULES]
    else:
        modules = [importlib.import_module(name) for name in MODULES.values()]
    calls = Calls(modules[0], modules[1], watched=not folder)
    for number in range(first, stop):
        random = np.random.default_rng([seed, number])
        calls.written.clear()
        maker = calls.makers[number % len(calls.makers)]
        function, given = maker(random)
        spoil = random.choice(
            len(given), min(len(given), int(random.integers(1, 4))), replace=False
        )
        for k in spoil.tolist():
            given[k] = spoilt(given[k], random)
        text = f"{maker.__name__}, other arguments {sorted(spoil.tolist())}"
        print(f"{number}\tbegun\t{text}", flush=True)
        faulthandler.dump_traceback_later(seconds, exit=True)
        try:
            function(*given)
            what = "done"
        except (TypeError, ValueError, MemoryError):
            what = "refused"
        except Exception as error:
            what, text = "wrong", f"{text}: {type(error).__name__}: {error}"
        faulthandler.cancel_dump_traceback_later()
        if not calls.untouched():
            what, text = "wrong", f"{text}: wrote beside its arrays"
        print(f"{number}\t{what}\t{text}", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), float(sys.argv[4]), sys.argv[5])
