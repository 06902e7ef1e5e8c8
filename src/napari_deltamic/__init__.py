"""Cell shapes in 3D, as meshes, from a fluorescence stack, by inverting the microscope.

The engine: nothing here imports Qt or napari. Names are loaded when they are used; ``__init__.pyi``
says from where.
"""

from importlib.metadata import PackageNotFoundError, version

import lazy_loader

from .common import freed_memory, idle_threads  # noqa: F401  (before anything that loads torch)

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__all__ += ["__version__"]

try:
    __version__ = version("napari-deltamic")
except PackageNotFoundError:  # running from a source tree that was never installed
    __version__ = "0+unknown"
