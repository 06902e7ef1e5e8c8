"""Cell shapes in 3D, as meshes, from a fluorescence stack, by inverting the microscope.

The engine: nothing here imports Qt or napari. Names are loaded when they are used; ``__init__.pyi``
says from where.
"""

import lazy_loader

from .common import freed_memory, idle_threads  # noqa: F401  (before anything that loads torch)

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
