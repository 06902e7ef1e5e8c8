"""A device that is not there: tensors of the CPU that say they are elsewhere.

Torch computes with them, on the CPU, but what a GPU refuses is refused: operations on tensors of
two devices, and numpy's view of a tensor that is not in its memory.
"""

import sys
from contextlib import contextmanager
from pathlib import Path

import torch
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_flatten

from napari_deltamic.fourier import particle_mesh
from napari_deltamic.fourier.cuda.build import POINTS

sys.path.append(str(Path(__file__).parent / "fourier"))  # where kernels run on the host

from cuda_emulation import Emulated

GPU = torch.device("cuda", 0)
_HERE = torch.device("cpu")
# As CUDA does: copies go across, and so do indices.
_ACROSS = {"aten::copy_", "aten::_to_copy", "aten::index", "aten::index_put", "aten::index_put_"}
_TO_NUMPY = {"numpy", "__array__", "__dlpack__"}


class _Places:
    """Which memory is on which device: written on what holds it.

    Of what torch makes for itself, on no tensor, nobody knows: it goes along with anything.
    """

    inside = False  # an operation, where torch itself is at work

    def of(self, t):
        """Whether on the device; None if not known."""
        return getattr(t.untyped_storage(), "on_gpu", False)

    def put(self, t, there):
        t.untyped_storage().on_gpu = there
        return t


class _Copy(torch.autograd.Function):
    """On the other device; gradients come back to this one."""

    @staticmethod
    def forward(ctx, t, places, there):
        ctx.places, ctx.there = places, there
        return places.put(t.clone(), there)

    @staticmethod
    def backward(ctx, grad):
        return ctx.places.put(grad.clone(), not ctx.there), None, None


def tensors(something):
    """All in nested arguments."""
    return [t for t in tree_flatten(something)[0] if isinstance(t, torch.Tensor)]


class _Operations(TorchDispatchMode):
    """Refuses what mixes devices; results lie where arguments do."""

    def __init__(self, places):
        super().__init__()
        self._places = places

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        given = tensors((args, kwargs or {}))
        places = [self._places.of(t) for t in given]
        name = func.name().split(".")[0]
        # A number goes along with anything.
        # So do the rows of a band, which are kept for each device.
        strange = any(
            a is False
            and t.dim()
            and not (name.startswith("deltamic::") and t.dtype == torch.int32)
            for t, a in zip(given, places, strict=True)
        )
        if True in places and strange and name not in _ACROSS:
            raise RuntimeError(f"{name}: tensors on two devices")
        before = {t.untyped_storage()._cdata for t in given}
        was, self._places.inside = self._places.inside, True
        try:
            out = func(*args, **(kwargs or {}))
        finally:
            self._places.inside = was
        known = [p for p in places if p is not None]
        where = None if not known else known[0] if name in _ACROSS else any(known)
        for t in tensors(out):
            if t.untyped_storage()._cdata not in before:
                # The engine brings the gradient of a number to where the number is.
                number = t.dim() == 0 and torch._C._current_graph_task_id() != -1
                self._places.put(t, None if number else where)
        return out


class _Functions(TorchFunctionMode):
    """Answers and obeys where a device is asked for or given."""

    def __init__(self, places):
        super().__init__()
        self._places = places

    def __torch_function__(self, func, types, args=(), kwargs=None):
        kwargs = dict(kwargs or {})
        if self._places.inside:
            return func(*args, **kwargs)
        name = getattr(func, "__name__", "")
        first = args[0] if args else None
        there = isinstance(first, torch.Tensor) and self._places.of(first)
        if func == torch.Tensor.device.__get__:
            return GPU if there else _HERE
        if func == torch.Tensor.is_cuda.__get__:
            return bool(there)
        if name in _TO_NUMPY and there:
            raise TypeError(f"{name}: numpy cannot see what is on a GPU")
        moves = func is torch.as_tensor and isinstance(args[0], torch.Tensor)
        if name in ("to", "cpu", "cuda") or moves:
            return self._moved(name, args, kwargs)
        asked = kwargs.get("device")
        if asked is not None:
            kwargs["device"] = _HERE
            return self._places.put(func(*args, **kwargs), torch.device(asked).type == GPU.type)
        out = func(*args, **kwargs)
        made = name.startswith("new_") or not tensors((args, kwargs))
        return self._places.put(out, there) if made and isinstance(out, torch.Tensor) else out

    def _moved(self, name, args, kwargs):
        t, *rest = args
        device, kind = None, None
        for a in [*rest, *kwargs.values()]:
            if isinstance(a, torch.Tensor):
                device, kind = GPU if self._places.of(a) else _HERE, a.dtype
            elif isinstance(a, torch.dtype):
                kind = a
            elif isinstance(a, (torch.device, str)):
                device = torch.device(a)
        if name in ("cpu", "cuda"):
            device = _HERE if name == "cpu" else GPU
        there = bool(self._places.of(t))
        out = t if kind is None else t.to(kind)
        if device is None or (device.type == GPU.type) == there:
            return out
        return _Copy.apply(out, self._places, not there)


def _kernels(device, single):
    return Emulated(single, POINTS[single]) if device.type == GPU.type else None


@contextmanager
def pretended_gpu(monkeypatch):
    """The device, which everything that asks for a GPU is given."""
    monkeypatch.setattr("napari_deltamic.fourier.devices.missing", lambda: "")
    monkeypatch.setattr(torch.cuda, "current_device", lambda: 0)
    monkeypatch.setattr(particle_mesh, "_kernels", _kernels)
    places = _Places()
    functions = _Functions(places)
    run = torch.autograd._engine_run_backward

    def backward(*args, **kwargs):
        with functions:  # which lets go of what it hands on
            return run(*args, **kwargs)

    monkeypatch.setattr(torch.autograd, "_engine_run_backward", backward)
    with functions, _Operations(places):
        yield GPU
