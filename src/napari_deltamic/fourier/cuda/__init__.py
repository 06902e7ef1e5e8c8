"""The closed form on NVIDIA GPUs: kernels compiled at first use (NVRTC), kept on disk.

Nothing but torch and ``cuda-bindings`` is needed, which CUDA builds of torch bring along; no CUDA
toolkit. Where a piece is missing everything runs on the CPU, and :func:`missing` says why.
"""

from .device import missing

__all__ = ["missing"]
