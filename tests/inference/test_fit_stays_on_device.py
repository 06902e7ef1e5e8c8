"""What a fit computes stays on its device: seen on the CPU, by tensors that tell who reads them."""

import sys
from collections import Counter
from functools import partial
from pathlib import Path

import pytest
import torch

import napari_deltamic as nd
from napari_deltamic.geometry import sphere
from napari_deltamic.inference import level, readings
from napari_deltamic.inference.surface import Surface
from napari_deltamic.scene import Renderer
from napari_deltamic.settings import FitSettings

PACKAGE = Path(nd.__file__).parent
# What a GPU has kernels of its own for, the transforms and the solver; and numbers that were copied
# aside some iterations ago.
KERNELS = {"fourier/closed_form.py", "fourier/nonuniform.py", "inference/factors.py"}
KERNELS |= {"inference/readings.py"}
# What waits for a device: all that gives a number, an array or a shape that depends on numbers.
WAITS = {
    *("__array__", "__bool__", "__contains__", "__float__", "__index__", "__int__", "cpu"),
    *("item", "masked_select", "nonzero", "numpy", "tolist", "unique"),
}
GRID, OPTICS = nd.Grid((24, 24, 24), (0.2, 0.2, 0.2)), nd.GaussianPSF(0.3)
TRUTH = sphere((2.4, 2.3, 2.3), 1.2, subdivisions=2)
START = sphere((2.3, 2.3, 2.3), 1.0, subdivisions=2)
# Iterations (from 1) in which a fit looks at itself: it plans and may remesh every 20, chooses
# voxels every 10, judges its progress every 12.
LOOKS = {1, 11, 12, 21, 24, 31, 36, 41}


def caller():
    """The file of the package that the present call comes from."""
    frame = sys._getframe(2)
    while frame is not None:
        path = Path(frame.f_code.co_filename)
        if PACKAGE in path.parents:
            return str(path.relative_to(PACKAGE))
        frame = frame.f_back
    return None


READ = Counter()  # what was read of the device, by file of the package


class OnDevice(torch.Tensor):
    """Stands for a tensor of a GPU; so does all that is computed from it."""

    @classmethod
    def __torch_function__(cls, func, types, args=(), kwargs=None):
        name = getattr(func, "__name__", "")
        masked = name == "__getitem__" and getattr(args[1], "dtype", None) == torch.bool
        if (name in WAITS or masked) and (place := caller()) and place not in KERNELS:
            READ[f"{place}: {name}"] += 1
        return super().__torch_function__(func, types, args, kwargs or {})


@pytest.fixture
def device(monkeypatch):
    """The vertices are on a device that stands apart; copies to it are counted as well."""
    on = Surface.on
    monkeypatch.setattr(Surface, "on", lambda self, there: on(self, there).as_subclass(OnDevice))
    monkeypatch.setattr(readings, "has_own_memory", lambda device: True)
    for name in ("tensor", "from_numpy", "as_tensor"):
        made = getattr(torch, name)

        def counted(*args, _made=made, _name=name, **kwargs):
            if (place := caller()) and place not in KERNELS:
                READ[f"{place}: torch.{_name}"] += 1
            return _made(*args, **kwargs)

        monkeypatch.setattr(torch, name, counted)


def read_in_each_iteration(**settings):
    """What was read of the device between two states, in iterations without a look."""
    image = nd.render(TRUTH, GRID, OPTICS, 1e-2)
    chosen = FitSettings(
        accuracy=1e-2, levels=(1.0,), tolerance=1e-9, max_iterations=40, **settings
    )
    states, found = nd.fit(image, GRID, START, OPTICS, settings=chosen), {}
    for iteration in range(1, 40):
        READ.clear()
        next(states)
        if iteration not in LOOKS:
            found[iteration] = dict(READ)
    return found


@pytest.mark.parametrize("density", ["uniform", "interface", "smooth"])
@pytest.mark.parametrize("method", ["closed form", "non-uniform"])
def test_an_iteration_reads_nothing_of_the_device(device, monkeypatch, method, density):
    monkeypatch.setattr(level, "Renderer", partial(Renderer, method=method))
    found = read_in_each_iteration(collisions=False, density=density)
    assert len(found) > 25
    assert not {i: read for i, read in found.items() if read}


def test_numbers_are_read_two_iterations_late(device):
    """On a device that stands apart; on the CPU at once."""
    told = readings.Readings()
    for loss in range(4):
        told.add("plan", torch.tensor(float(loss)))
    assert told.read(leave=readings.late(torch.device("cpu"))) == [("plan", [0.0]), ("plan", [1.0])]
    assert len(told) == 2
    assert [numbers for _, (numbers,) in told.read()] == [2.0, 3.0]


def test_a_step_that_leaves_no_ball_is_not_looked_at(device):
    """The guard against collisions asks for one number, and for the vertices only now and then."""
    found = read_in_each_iteration(collisions=True, step=1e-4)
    ask = {"inference/collisions.py: __bool__": 1}
    assert [read for read in found.values() if read == ask]
    assert {name for read in found.values() for name in read} <= {
        "inference/collisions.py: __bool__",
        "inference/collisions.py: torch.tensor",
        "inference/surface.py: cpu",
        "inference/surface.py: numpy",
    }


def test_a_device_that_stands_apart_makes_the_same_fit(device):
    """Late numbers may have it plan earlier; nothing else."""
    ends = []
    for apart in (True, False):
        readings.has_own_memory = lambda device, apart=apart: apart
        image = nd.render(TRUTH, GRID, OPTICS, 1e-2)
        chosen = FitSettings(accuracy=1e-2, max_iterations=60)
        ends.append(list(nd.fit(image, GRID, START, OPTICS, settings=chosen))[-1])
    assert ends[0].loss == pytest.approx(ends[1].loss, rel=0.05)
