"""Fourier transform of triangle meshes: closed form, particle-mesh, and the plan between them."""

from .band import Band
from .closed_form import mesh_ft
from .cuda import operators as _operators  # noqa: F401  (registers the kernels with torch)
from .native import native, simd_level
from .plan import Plan, make_plan

__all__ = ["Band", "Plan", "make_plan", "mesh_ft", "native", "simd_level"]
