"""What a fit no longer needs goes at once, without a collector of garbage."""

import gc

import pytest

from napari_deltamic.common import freed_memory
from napari_deltamic.fitting.objective.fit_objective import Objective
from napari_deltamic.runs.settings import FitSettings
from napari_deltamic.scene import Renderer
from synthetic import fitted, measured


@pytest.fixture
def uncollected():
    gc.collect()
    gc.disable()
    yield
    gc.enable()


@pytest.mark.parametrize("structure", ["membrane", "both"])
def test_objectives_and_renderers_do_not_wait_for_a_collector(uncollected, structure):
    settings = FitSettings(max_iterations=8, structure=structure, levels=(2.0, 1.0))
    fitted(measured(), settings=settings)
    assert not [one for one in gc.get_objects() if type(one) in (Objective, Renderer)]


def test_free_memory_goes_back_once_there_is_much_of_it(monkeypatch):
    given = []
    in_use = [100 << 20]
    monkeypatch.setattr(freed_memory, "give_back", lambda: given.append(in_use[0]))
    monkeypatch.setattr(freed_memory, "_resident", lambda: in_use[0])
    spare = freed_memory.SpareMemory()
    for much in (100, 500, 600, 884, 885):
        in_use[0] = much << 20
        spare.give_back()
    assert given == [500 << 20, 885 << 20]  # 385 more than was left the time before


def test_a_system_that_does_not_tell_is_left_alone(monkeypatch, tmp_path):
    monkeypatch.setattr(freed_memory, "Path", lambda name: tmp_path / "statm")
    assert freed_memory._resident() == 0
