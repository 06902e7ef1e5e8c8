"""Layers that show meshes, and where they lie in the viewer."""
