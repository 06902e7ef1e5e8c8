"""One task in one interpreter: ``python -P child.py FOLDER``, started by :mod:`.jobs`.

Runs in any Python in which napari_deltamic is installed, be it older than this tree. So it imports
nothing of the benchmarks, and of the package only what both versions have. Reads ``job.json`` and
``input.npz`` of the folder, writes ``outcome.json`` and ``outcome.npz``.
"""

from __future__ import annotations

import importlib
import json
import resource
import sys
import time
import traceback
import warnings
from pathlib import Path
from typing import Any

import numpy as np

import napari_deltamic as nd

Arrays = dict[str, Any]
Values = dict[str, Any]
_SNAPSHOTS = 1.08  # a mesh is kept each time the seconds have grown by this factor


def fit(job: Values, given: Arrays) -> tuple[Values, Arrays]:
    """A fit to its end; then, where asked, pushes on the surface and the fit from there."""
    start = _start(job, given)
    states = nd.fit(
        given["image"],
        _grid(job, given["image"].shape),
        start,
        nd.GaussianPSF(job["sigma"]),
        settings=_settings(job),
    )
    course = _Course(job.get("snapshots", False))
    state = course.follow(states)
    values: Values = {"seconds": course.seconds, "cpu": course.cpu, **_described(state)}
    values["snapshot_seconds"] = course.kept_at
    if job.get("predict"):
        grid = _grid(job, given["image"].shape)
        values["volume_sd"] = _volume_sd(given, grid, state, _settings(job))
    arrays = _as_arrays(state.mesh, "mesh")
    for number, mesh in enumerate(course.kept):
        arrays |= _as_arrays(mesh, f"snapshot{number}")
    pushes = given.get("pushes", ())
    values["pushed"] = bool(len(pushes)) and bool(state.converged)
    if values["pushed"]:
        moved = _pushed(state.mesh, pushes, job["push"], job["push_radius"])
        arrays |= _as_arrays(moved, "moved")
        again = _Course(False)
        state = again.follow(states, nd.Change(mesh=moved))
        values["again"] = {"seconds": again.seconds, **_described(state)}
        arrays |= _as_arrays(state.mesh, "again")
    return values, arrays


class _Course:
    """A fit followed; the clock stands still while something is kept."""

    def __init__(self, snapshots: bool) -> None:
        self.seconds = self.cpu = 0.0
        self.kept: list[Any] = []
        self.kept_at: list[float] = []
        self._snapshots = snapshots

    def follow(self, states: Any, change: Any = None) -> Any:
        """The last state; it waits for a change where the fit converged."""
        while True:
            began, cpu = time.perf_counter(), time.process_time()
            try:
                state = next(states) if change is None else states.send(change)
            except StopIteration:
                return state
            change = None
            _ = state.mesh  # some states hold their mesh back until it is asked for
            self.seconds += time.perf_counter() - began
            self.cpu += time.process_time() - cpu
            if self._snapshots and self.seconds > _SNAPSHOTS * (self.kept_at or [0.0])[-1]:
                self.kept.append(state.mesh)
                self.kept_at.append(self.seconds)
            if state.converged:
                return state


def _described(state: Any) -> Values:
    widths = getattr(state.optics, "sigma_um", None)
    return {
        "iterations": int(state.iteration),
        # Versions that do not count them need one an iteration, or a little more.
        "evaluations": int(getattr(state, "evaluations", None) or state.iteration),
        "loss": float(state.loss),
        "converged": bool(state.converged),
        "message": state.message,
        "sigma": None if widths is None else [float(w) for w in widths],
    }


def _volume_sd(given: Arrays, grid: Any, state: Any, settings: Any) -> float | None:
    """um^3: the standard deviation of the volume that the fit predicts; None where it does not."""
    try:
        module = _from(
            "fitting.uncertainty.errors_of_measures",
            "fitting.errors_of_measures",
            "inference.errors_of_measures",
        )
    except ModuleNotFoundError:
        return None
    if hasattr(module, "predicted_volume_sd"):
        found = module.predicted_volume_sd(given["image"], grid, state, settings)
        return float(next(iter(found.values())).sandwich)
    from napari_deltamic.measure.of_fit import replicas_at

    pairs = replicas_at(given["image"], grid, state, settings).pairs()
    region = int(state.mesh.region_ids()[0])
    return float(np.std([a.volumes()[region] - b.volumes()[region] for a, b in pairs]) / 2)


def _pushed(mesh: Any, points: Any, by: float, radius: float) -> Any:
    """The surface pushed outward at the vertices nearest to some points, as a brush does it."""
    places, normals = mesh.vertices_numpy().copy(), np.zeros((len(mesh.vertices), 3))
    # Out of the cell with the larger number, so that a wall is pushed as one.
    side = np.where(mesh.regions[:, 0] > mesh.regions[:, 1], 1.0, -1.0)
    per_face = mesh.normals() * (side * mesh.areas())[:, None]
    for corner in range(3):
        np.add.at(normals, mesh.faces[:, corner], per_face)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    moved = places.copy()
    for point in points:
        touched = np.linalg.norm(places - point, axis=1).argmin()
        away = np.linalg.norm(places - places[touched], axis=1)
        share = np.clip(1 - (away / radius) ** 2, 0, None) ** 2
        moved += by * share[:, None] * normals[touched]
    return mesh.with_vertices(moved)


def render(job: Values, given: Arrays) -> tuple[Values, Arrays]:
    """Seconds of an image with its gradient: with all that a first image needs, and without."""
    import torch

    mesh, grid = _mesh(given, "start"), _grid(job, job["shape"])
    optics = nd.GaussianPSF(job["sigma"])
    vertices = torch.tensor(mesh.vertices_numpy(), requires_grad=True)
    target = torch.ones(tuple(job["shape"]))
    if job["save"]:
        target = torch.randn(tuple(job["shape"]), generator=torch.Generator().manual_seed(1))

    def once() -> tuple[Any, Any]:
        image = nd.render(nd.Mesh(vertices, mesh.faces), grid, optics, job["accuracy"])
        return image, torch.autograd.grad(image, vertices, target.to(image.dtype))[0]

    first = _timed(once, job["repeats"])
    planned, points = _planned(mesh, grid, optics, job["accuracy"], vertices, target)
    values = {"first": first, "seconds": _timed(planned, job["repeats"]), "points": points}
    if not job["save"]:
        return values, {}
    image, gradient = planned()
    return values, {"image": image.detach().numpy(), "gradient": gradient.numpy()}


def finufft(job: Values, given: Arrays) -> tuple[Values, Arrays]:
    """The same by FINUFFT alone, at the points and on the band of the plan, and no less exact.

    Knows more of the package than the other tasks: ``rules`` and ``band`` of a plan. It runs in the
    present version only.
    """
    from napari_deltamic.scene import Renderer, Scene

    sys.path.append(str(Path(__file__).parent))
    from with_finufft import measured  # type: ignore[import-not-found]

    mesh, grid = _mesh(given, "start"), _grid(job, given["exact"].shape)
    plan = Renderer(Scene.of(mesh, nd.GaussianPSF(job["sigma"])), grid, job["accuracy"]).plan
    mass = mesh.areas() * mesh.membranes()
    corners = mesh.vertices_numpy()[mesh.faces]
    points = [(rule.barycentric @ corners[faces]).reshape(-1, 3) for rule, faces in plan.rules]
    weights = [(mass[faces][:, None] * rule.weights).reshape(-1) for rule, faces in plan.rules]
    job = {**job, "fft_shape": plan.band.fft_shape, "half": plan.band.half}
    every = np.concatenate(points), np.concatenate(weights)
    return {"points": len(every[0]), **measured(job, *every, given["exact"], _timed)}, {}


def _planned(
    mesh: Any, grid: Any, optics: Any, accuracy: float, vertices: Any, target: Any
) -> tuple[Any, int]:
    """An evaluation as a fit makes them, the plan being there already; and its points."""
    import torch

    from napari_deltamic import scene

    if hasattr(scene.Scene, "of"):
        renderer = scene.Renderer(scene.Scene.of(mesh, optics), grid, accuracy)
    else:  # an older version
        renderer = scene.Renderer(mesh, grid, optics, accuracy)

    def evaluation() -> tuple[Any, Any]:
        image = renderer.image(renderer.transform(vertices), renderer.otf(optics))
        return image, torch.autograd.grad(image, vertices, target.to(image.dtype))[0]

    return evaluation, int(renderer.plan.points)


def _timed(function: Any, repeats: int) -> list[float]:
    function()
    seconds = []
    for _ in range(repeats):
        began = time.perf_counter()
        function()
        seconds.append(time.perf_counter() - began)
    return seconds


def command(job: Values, given: Arrays) -> tuple[Values, Arrays]:
    """The whole command line, and the mesh that it wrote."""
    from napari_deltamic.cli import main

    began = time.perf_counter()
    code = main([*job["words"], "-o", "result"])
    seconds = time.perf_counter() - began
    if code != 0:
        raise RuntimeError(f"the command ended with code {code}")
    report = json.loads(Path("result/report.json").read_text())
    values = {"seconds": seconds, "iterations": report["iterations"], "report": report}
    return values, _as_arrays(nd.load_mesh("result/mesh.rec"), "mesh")


def track(job: Values, given: Arrays) -> tuple[Values, Arrays]:
    """A series of images; the mesh of each frame, and what happened to its cells."""
    run = _from("tracking", "inference.tracking").track
    images, grid = given["images"], _grid(job, given["images"].shape[1:])
    began, done = time.perf_counter(), []
    for state in run(iter(images), grid, _mesh(given, "start"), nd.GaussianPSF(job["sigma"])):
        if state.done is not None:
            done.append(state.done)
    values: Values = {"seconds": time.perf_counter() - began, "frames": []}
    arrays: Arrays = {}
    for result in done:
        events = [[e.kind, int(e.cell), [int(d) for d in e.daughters]] for e in result.events]
        values["frames"].append({"found": result.mesh is not None, "events": events})
        if result.mesh is not None:
            arrays |= _as_arrays(result.mesh, f"frame{result.frame}")
    return values, arrays


def evidence(job: Values, given: Arrays) -> tuple[Values, Arrays]:
    """A fit without effects, those that it calls for, and the fit with them."""
    recommend = _from("evidence", "inference.evidence").recommend
    image, optics = given["image"], nd.GaussianPSF(job["sigma"])
    grid, start, settings = _grid(job, image.shape), _mesh(given, "start"), _settings(job)
    began = time.perf_counter()
    *_, plain = nd.fit(image, grid, start, optics, settings=settings)
    middle = time.perf_counter()
    found = recommend(image, grid, plain.mesh, optics, settings, fitted=plain)
    values = {"fit": middle - began, "seconds": time.perf_counter() - middle}
    values["recommended"] = list(found.recommended)
    *_, last = nd.fit(image, grid, start, optics, settings=settings, effects=found.effects)
    return {**values, **_described(last)}, _as_arrays(last.mesh, "mesh")


def _from(*names: str) -> Any:
    """The first module of these that this version of the package has."""
    for name in names:
        try:
            return importlib.import_module(f"napari_deltamic.{name}")
        except ModuleNotFoundError:
            continue
    raise ModuleNotFoundError(f"napari_deltamic has none of {', '.join(names)}")


# ------------------------------------------------------------------------------- in and out


def _grid(job: Values, shape: Any) -> Any:
    return nd.Grid(tuple(int(n) for n in shape), tuple(job["voxel_size"]))


def _settings(job: Values) -> Any:
    """The defaults but for what the job names; near levels for labels, as every user has them."""
    chosen, module = dict(job.get("settings", {})), _from("runs.settings", "settings")
    if job.get("near"):
        chosen.setdefault("levels", getattr(module, "NEAR_LEVELS", None))
    return module.FitSettings(**{k: v for k, v in chosen.items() if v is not None})


def _start(job: Values, given: Arrays) -> Any:
    """The mesh to start from; of labels, what this version makes of them."""
    if not job.get("labels"):
        return _mesh(given, "start")
    from napari_deltamic.geometry import mesh_from_labels

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of labels repaired
        return mesh_from_labels(given["labels"], job["voxel_size"])


def _mesh(given: Arrays, name: str) -> Any:
    return nd.Mesh(*(given[f"{name}_{part}"] for part in ("vertices", "faces", "regions")))


def _as_arrays(mesh: Any, name: str) -> Arrays:
    return {
        f"{name}_vertices": mesh.vertices_numpy(),
        f"{name}_faces": mesh.faces,
        f"{name}_regions": mesh.regions,
    }


def _peak() -> int:
    """Bytes of memory that the process held at most."""
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


TASKS = {
    "fit": fit,
    "render": render,
    "finufft": finufft,
    "command": command,
    "track": track,
    "evidence": evidence,
}


def main(folder: Path) -> int:
    job = json.loads((folder / "job.json").read_text())
    with np.load(folder / "input.npz") as file:
        given = dict(file)
    cpu = time.process_time()
    try:
        values, arrays = TASKS[job["task"]](job, given)
        values.setdefault("cpu", time.process_time() - cpu)
    except Exception as error:  # a fit that breaks down is a result too
        traceback.print_exc()
        values, arrays = {"failed": f"{type(error).__name__}: {error}"}, {}
    values["peak_bytes"] = _peak()
    np.savez(folder / "outcome.npz", **arrays)
    (folder / "outcome.json").write_text(json.dumps(values))
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
