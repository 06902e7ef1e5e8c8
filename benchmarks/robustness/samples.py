"""Good files of every kind that the package reads, small, and what reads them."""

from __future__ import annotations

import io
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import tifffile

import napari_deltamic as nd
from napari_deltamic.fitting import fit
from napari_deltamic.fitting.history import History
from napari_deltamic.geometry import read_points_csv, sphere
from napari_deltamic.images.series import open_series
from napari_deltamic.images.stacks import read_image, write_image
from napari_deltamic.results.scene_file import load_scene, save_scene
from napari_deltamic.results.session_file import load_session, save_session
from napari_deltamic.results.session_parts import SavedImage, SavedLayer, SavedResult, Session
from napari_deltamic.results.track_report import read_results, write_frame, write_tracks
from napari_deltamic.runs.optics_settings import optics_from_toml
from napari_deltamic.runs.settings import FitSettings, RunSettings, SceneSettings
from napari_deltamic.scene import render_scene
from napari_deltamic.scene.effects import Effects
from napari_deltamic.scene.structures import Filament, Points, Solid, Surface

GRID = nd.Grid((9, 10, 11), (0.3, 0.2, 0.2))
OPTICS = nd.GaussianPSF((0.36, 0.24, 0.24))
FIT = FitSettings(levels=(2.0, 1.0), max_iterations=3)
PLACE: dict[str, Any] = {
    "scale": (0.3, 0.2, 0.2), "translate": (0.0, 0.0, 0.0), "units": ("micrometer",) * 3
}  # fmt: skip

Reader = Callable[[Path], Any]


def image() -> np.ndarray:
    """Of a cell, with noise."""
    cell = nd.render(sphere((1.2, 0.9, 1.0), 0.7, edge_length=0.3), GRID, OPTICS).numpy()
    rng = np.random.default_rng(0)
    return rng.poisson(100 + 400 * cell / cell.max()).astype(np.float32)


def start() -> nd.Mesh:
    """Where a fit of it begins."""
    return sphere((1.2, 0.9, 1.0), 0.55, edge_length=0.4)


def resume(path: Path) -> None:
    """A fit that goes on from a checkpoint, for an iteration."""
    pixels, states = image(), None
    states = fit(pixels, GRID, start(), OPTICS, settings=FIT, resume=path)
    next(states)
    states.close()


def samples(folder: Path) -> dict[str, tuple[Path, Reader]]:
    """Name -> file and its reader; the files are made in a folder."""
    mesh, pixels = start(), image()
    found: dict[str, tuple[Path, Reader]] = {}
    for kind in ("obj", "off", "ply", "stl", "rec", "vtk"):
        path = folder / f"mesh.{kind}"
        nd.save_mesh(mesh, path)
        found[kind] = path, nd.load_mesh
    _further_meshes(folder, mesh, found)
    write_image(folder / "image.tif", pixels, GRID.voxel_size)
    write_image(folder / "image.ome.tif", pixels.astype(np.float64), GRID.voxel_size)
    small = pixels.astype(np.uint16)
    tifffile.imwrite(folder / "packed.tif", small, compression="zlib", metadata={"axes": "ZYX"})
    np.save(folder / "image.npy", pixels)
    for name in ("image.tif", "image.ome.tif", "packed.tif", "image.npy"):
        found[name] = folder / name, read_image
    named = {"axes": "ZCYX", "Channel": {"Name": ["a", "b"]}}
    both = np.stack([small, small], axis=1)
    tifffile.imwrite(folder / "channels.ome.tif", both, ome=True, metadata=named)
    found["channels.ome.tif"] = folder / "channels.ome.tif", lambda p: read_image(p, "b")
    tifffile.imwrite(folder / "series.tif", np.stack([small] * 2), metadata={"axes": "TZYX"})
    np.save(folder / "series.npy", np.stack([pixels] * 2))
    for name in ("series.tif", "series.npy"):
        found[name] = folder / name, _whole_series
    (folder / "points.csv").write_text("z,y,x,radius\n1.2,0.9,1.0,0.5\n0.4,0.5,0.6,\n")
    found["points"] = folder / "points.csv", read_points_csv
    run = settings(folder)
    (folder / "run.toml").write_text(run.to_toml())
    found["run"] = folder / "run.toml", RunSettings.from_toml
    (folder / "psf.toml").write_text(
        'kind = "gaussian"\ncovariance = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\n'
    )
    found["psf"] = folder / "psf.toml", lambda p: optics_from_toml(p).build()
    for state in fit(pixels, GRID, mesh, OPTICS, settings=FIT):
        last = state
    last.save(folder / "state.npz")
    found["checkpoint"] = folder / "state.npz", resume
    save_session(folder / "all.deltamic", session(last, run, pixels))
    found["session"] = folder / "all.deltamic", lambda p: load_session(p).result.state.rendered()  # type: ignore[union-attr]
    save_scene(scene(), folder / "scene.zip")
    found["scene"] = folder / "scene.zip", lambda p: render_scene(load_scene(p), GRID, 1e-2)
    _tracks(folder / "tracks", found)
    return found


def scene() -> nd.Scene:
    """With a structure of every kind."""
    path = np.array([[0.5, 0.5, 0.5], [1.5, 1.0, 1.5]])
    structures = (Surface(start()), Solid(start()), Filament(path), Points(path))
    return nd.Scene(structures, OPTICS, Effects.of("pixel_integration"))


def settings(folder: Path) -> RunSettings:
    """Of a run on these files."""
    scene = SceneSettings(voxel_size=GRID.voxel_size, sigma=(0.36, 0.24, 0.24))
    files = str(folder / "image.npy"), str(folder / "mesh.ply")
    return RunSettings(image=files[0], seeds=files[1], scene=scene, fit=FIT)


def _whole_series(path: Path) -> list[np.ndarray]:
    series = open_series(path)
    return [series[t] for t in range(len(series))]


def session(state: nd.FitState, run: RunSettings, pixels: np.ndarray) -> Session:
    """A session with a result."""
    points = {"data": np.ones((2, 3)), "size": np.ones(2)}
    history = History([0.9], [1], [2.0])
    return Session(
        settings=run,
        image=SavedImage("image", pixels, GRID.voxel_size, **PLACE),
        seeds=(SavedLayer("points", "seeds", points, **PLACE),),
        result=SavedResult(run, replace(state, message="done"), history, start=start()),
        panels={"seeds": {"kind": "points"}},
    )


def _further_meshes(folder: Path, mesh: nd.Mesh, found: dict[str, tuple[Path, Reader]]) -> None:
    """Ways to write meshes that the package reads but does not use itself."""
    xyz, faces = mesh.vertices_numpy()[:, ::-1], mesh.faces
    import trimesh

    texts: dict[str, bytes] = {}
    for kind, options in (("ply", {"encoding": "ascii"}), ("stl_ascii", {})):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            solid = trimesh.Trimesh(xyz, faces, process=False)
            data = solid.export(file_type=kind, **options)
        texts["ascii." + kind[:3]] = data.encode() if isinstance(data, str) else data
    rows = "".join(f"{x} {y} {z}\n" for x, y, z in xyz)
    head = "# vtk DataFile Version 3.0\nmesh\nASCII\nDATASET POLYDATA\n"
    cells = "".join(f"3 {a} {b} {c}\n" for a, b, c in faces)
    text = f"{head}POINTS {len(xyz)} double\n{rows}POLYGONS {len(faces)} {4 * len(faces)}\n{cells}"
    texts["ascii.vtk"] = text.encode()
    offsets = " ".join(map(str, range(0, 3 * len(faces) + 1, 3)))
    corners = " ".join(map(str, faces.ravel()))
    texts["new.vtk"] = (
        f"{head.replace('3.0', '5.1')}POINTS {len(xyz)} double\n{rows}"
        f"POLYGONS {len(faces) + 1} {3 * len(faces)}\nOFFSETS vtktypeint64\n{offsets}\n"
        f"CONNECTIVITY vtktypeint64\n{corners}\n"
    ).encode()
    table = io.BytesIO()
    table.write(np.uint64(len(xyz)).tobytes() + xyz.astype("<f8").tobytes())
    table.write(np.uint64(len(faces)).tobytes())
    kind = np.dtype([("corners", "<u8", 3), ("regions", "<i4", 2)])
    rows_of = np.zeros(len(faces), kind)
    rows_of["corners"], rows_of["regions"] = faces, mesh.regions
    texts["binary.rec"] = table.getvalue() + rows_of.tobytes()
    for name, data in texts.items():
        (folder / name).write_bytes(data)
        found[name] = folder / name, nd.load_mesh


def _tracks(folder: Path, found: dict[str, tuple[Path, Reader]]) -> None:
    """The folder of a tracked series; its report is what is spoilt."""
    from napari_deltamic.runs.track_run import TrackRun
    from napari_deltamic.tracking import FrameResult

    folder.mkdir()
    mesh = start()
    results = [
        FrameResult(t, float(t), mesh, "", (), 0.1, 3, 1.0, (0.36, 0.24, 0.24)) for t in range(2)
    ]
    for result in results:
        write_frame(folder, result)
    run = settings(folder).model_dump()
    write_tracks(folder, results, GRID, TrackRun(**run), 1.0, surface=False)
    found["tracks"] = folder / "report.json", lambda p: read_results(p.parent)
