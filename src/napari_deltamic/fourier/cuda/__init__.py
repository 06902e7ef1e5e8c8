"""Transforms on NVIDIA GPUs: kernels compiled at first use (NVRTC), kept on disk.

Nothing but torch and ``cuda-bindings`` is needed, which CUDA builds of torch bring along; no CUDA
toolkit. Where a piece is missing fits run on the CPU, and :func:`missing` says why; points that lie
on a GPU all the same are spread by torch there, and the closed form goes to the CPU.
"""

from .device import missing

__all__ = ["missing"]
