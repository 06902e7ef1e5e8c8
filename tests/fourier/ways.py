"""Ways to transform points: compiled loops, torch, and the kernels of a GPU, on the host."""

from cuda_emulation import SMALL_POINTS, Emulated

from napari_deltamic.fourier import particle_mesh, real_fft, solid_plan

WAYS = ("compiled", "torch", "GPU")


def use_torch(monkeypatch, instead=True):
    for module in (particle_mesh, real_fft):
        monkeypatch.setattr(module, "compiled", lambda device: not instead)


def use_gpu_kernels(monkeypatch):
    monkeypatch.setattr(
        particle_mesh, "_kernels", lambda device, single: Emulated(single, SMALL_POINTS[single])
    )
    monkeypatch.setattr(solid_plan, "_has_atomics", lambda device: True)


def take(way, monkeypatch):
    """Go one of the ways."""
    use_torch(monkeypatch, way != "compiled")
    if way == "GPU":
        use_gpu_kernels(monkeypatch)
