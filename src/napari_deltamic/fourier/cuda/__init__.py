"""Transforms on NVIDIA GPUs: kernels compiled at first use (NVRTC), kept on disk.

They need only torch and ``cuda-bindings``, which CUDA builds of torch install, and no CUDA toolkit.
If something is missing, fits run on the CPU and :func:`missing` says why; points that lie on a GPU
all the same are then spread by torch there, and the closed form is computed on the CPU.
"""

from .device import missing

__all__ = ["missing"]
