"""A small cell for the command line to fit, and two ways to run it in this process."""

import numpy as np
import pytest

import napari_deltamic as nd
from napari_deltamic.cli import main
from napari_deltamic.evidence import fit_facts
from napari_deltamic.evidence.predicted_error import PredictedError
from napari_deltamic.fitting import fit
from napari_deltamic.geometry import sphere
from napari_deltamic.images.stacks import write_image
from napari_deltamic.results import html_page, report

SIZE = (0.3, 0.2, 0.2)
SHAPE = (20, 24, 24)
CENTER = (2.9, 2.3, 2.3)


@pytest.fixture(autouse=True)
def quick(monkeypatch, request, a_picture):
    """What takes longer than a fit of few iterations, and few tests ask for, is left out."""
    if "judged" not in request.fixturenames:
        unknown = PredictedError(unknown="not asked for")
        monkeypatch.setattr(fit_facts, "predicted_error", lambda *given: unknown)
        for module in (report, html_page):
            monkeypatch.setattr(module, "picture_png", lambda *given: a_picture)


@pytest.fixture
def judged():
    """For tests of the picture of a fit and of how good it is, or that compare with a child's."""


@pytest.fixture(scope="session")
def data(tmp_path_factory):
    """A folder with a small image of a cell, and everything that can start a fit of it."""
    folder = tmp_path_factory.mktemp("cell")
    grid = nd.Grid(SHAPE, SIZE)
    truth = sphere(CENTER, (1.2, 1.1, 1.1), edge_length=0.3)
    image = nd.render(truth, grid, nd.GaussianPSF((0.36, 0.24, 0.24))).numpy()
    image = np.random.default_rng(0).poisson(100 + 400 * image / image.max()).astype(np.float32)
    write_image(folder / "cell.tif", image, SIZE)
    np.save(folder / "cell.npy", image)
    nd.save_mesh(sphere(CENTER, 1.0, edge_length=0.5), folder / "start.ply")
    place = np.stack(np.indices(grid.shape), axis=-1) * SIZE
    labels = np.linalg.norm(place - CENTER, axis=-1) < 1
    write_image(folder / "labels.tif", labels.astype(np.uint16), SIZE)
    point = ",".join(map(str, CENTER))
    (folder / "points.csv").write_text(f"z,y,x\n{point}\n")
    (folder / "balls.csv").write_text(f"z,y,x,radius\n{point},1.0\n")
    for name, value in (("nan", np.nan), ("inf", -np.inf)):
        holed = image.copy()
        holed[:2, 3, 4] = value
        write_image(folder / f"{name}.tif", holed, SIZE)
    return folder


@pytest.fixture
def run(capsys):
    """Run a command: exit code, lines of stdout, text of stderr."""

    def run(*arguments):
        code = main([str(argument) for argument in arguments])
        out, err = capsys.readouterr()
        return code, out.splitlines(), err

    return run


@pytest.fixture
def fails(run):
    """Run a command that must fail, with nothing on stdout: its one line of stderr."""

    def fails(*arguments, code=2):
        found, out, err = run(*arguments)
        assert found == code, err
        assert out == []
        assert err.startswith("napari-deltamic: error: ")
        assert err.count("\n") == 1
        assert err.endswith("\n")
        return err

    return fails


@pytest.fixture
def seen(monkeypatch):
    """What the command line asks of the engine; the fit itself is cut to one iteration."""
    calls = []

    def short(*arguments, **options):
        calls.append((arguments, options))
        yield next(iter(fit(*arguments, **options)))

    monkeypatch.setattr("napari_deltamic.fitting.job.fit", short)
    return calls
