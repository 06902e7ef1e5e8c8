"""Names of the files that measuring writes; imports nothing heavy, for the command line."""

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
# Written only where they are asked for, or for tracks.
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
