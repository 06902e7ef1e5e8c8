"""Meshes of cells: the Mesh itself, simple shapes, starting surfaces, repair, and files.

Names are loaded when they are used; ``__init__.pyi`` says from where.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
