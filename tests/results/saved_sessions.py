"""Sessions that are saved, and changed as files: what the tests of session files share."""

import zipfile

import numpy as np

import napari_deltamic as nd
from napari_deltamic.fitting.history import History
from napari_deltamic.geometry import sphere
from napari_deltamic.results.session_parts import SavedImage, SavedLayer, SavedResult, Session
from napari_deltamic.results.timeline import Moment
from napari_deltamic.runs.settings import FitSettings, RunSettings, SceneSettings
from napari_deltamic.scene.effects import Effects, Halo

SHAPE, SIZE = (6, 7, 8), (0.3, 0.1, 0.2)
PLACE = {"scale": (300.0, 100.0, 200.0), "translate": (1.5, 0.0, -2.0), "units": ("nanometer",) * 3}


def settings(**fit):
    return RunSettings(
        image="", seeds="", scene=SceneSettings(voxel_size=SIZE), fit=FitSettings(**fit)
    )


def two_cells():
    parts = [sphere((0.8, 0.3, x), 0.2, edge_length=0.2) for x in (0.4, 1.0)]
    return nd.Mesh.merge(parts)


def session(dtype=np.float32):
    rng = np.random.default_rng(0)
    pixels = (100 * rng.random(SHAPE)).astype(dtype)
    if np.issubdtype(dtype, np.floating):
        pixels[1, 2, 3] = np.nan
    mesh = two_cells()
    moved = [mesh.with_vertices(mesh.vertices_numpy() + 1e-3 * k / 3) for k in range(4)]
    optics = nd.GaussianPSF((0.1 + 0.2, 1 / 3, 0.7))
    state = nd.FitState(
        iteration=12,
        level=2,
        levels=3,
        mesh=moved[3],
        optics=optics,
        density=rng.random(len(mesh.faces)),
        loss=1 / 3,
        amplitude=np.pi,
        background=-2 / 7,
        blur=1.35,
        converged=True,
        message="converged",
        moving=(0.25, 1 / 3, 2.0),
        effects=Effects.of(Halo(fraction=1 / 3), "pixel_integration"),
    )
    result = SavedResult(
        settings=settings(density="smooth", levels=(2.0, 1.0)),
        state=state,
        history=History([0.9, 2 / 3, 1 / 3], [1, 1, 2], [2.0, 2.0, 1.0], first=10),
        seconds=1.25,
        verdict="converged",
        message="converged (12 iterations)",
        start=mesh,
        counted=rng.random(SHAPE) < 0.5,
        moments=tuple(
            Moment(
                iteration=k,
                loss=1 / (k + 3) if k else np.nan,
                mesh=moved[k],
                optics=optics,
                note=f"note {k}",
            )
            for k in range(3)
        ),
    )
    points = SavedLayer(
        "points", "zweite Höhle", {"data": rng.random((2, 3)), "size": rng.random(2)}, **PLACE
    )
    labels = SavedLayer("labels", "l", {"data": rng.integers(0, 9, SHAPE, np.uint8)}, **PLACE)
    display = {"contrast_limits": [0.1, 99.5], "colormap": {"name": "gray"}}
    return Session(
        settings=settings(accuracy=3e-3),
        image=SavedImage("cells", pixels, SIZE, display=display, **PLACE),
        seeds=(points, labels),
        result=result,
        panels={"start as": "sphere", "radius": 0.1},
    )


def same(a, b):
    """Bit for bit, not a number included."""
    return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()


def same_mesh(a, b):
    return (
        same(a.vertices_numpy(), b.vertices_numpy())
        and same(a.faces, b.faces)
        and same(a.regions, b.regions)
    )


def rewritten(source, target, change):
    """A copy of a session file in which ``change`` replaces members."""
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(target, "w") as new:
        for name in old.namelist():
            data = change(name, old.read(name))
            if data is not None:
                new.writestr(name, data)
