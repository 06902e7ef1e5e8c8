"""Fourier transform of triangle meshes: closed form, non-uniform FFT, and the plan between them."""

from .band import Band
from .closed_form import mesh_ft
from .cuda import operators as _operators  # noqa: F401  (registers the kernels with torch)
from .cuda import points as _points  # noqa: F401
from .native import SlowPathWarning, native, simd_level
from .plan import Plan, make_plan

__all__ = ["Band", "Plan", "SlowPathWarning", "make_plan", "mesh_ft", "native", "simd_level"]
