"""The files that measuring leaves; free of the engine, so that the command line knows them too."""

# In the order in which they are written.
MEASURED = (
    "cells.csv",
    "walls.csv",
    "junctions.csv",
    "cells.vtk",
    "cells.ply",
    "walls.vtk",
    "walls.ply",
    "labels.ome.tif",
    "measurements.html",
)
# Only where they are asked for, or of tracks.
FURTHER = (
    "channel_walls.csv",
    "channel_cells.csv",
    "rendered.ome.tif",
    "residual.ome.tif",
    "labels.ome.zarr",
    "rendered.ome.zarr",
    "residual.ome.zarr",
    "tracks.csv",
    "tracks.geff",
)
