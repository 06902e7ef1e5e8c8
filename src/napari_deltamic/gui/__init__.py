"""What napari users see: panels, the viewer link, and the worker that runs a fit."""
