"""Figures of clusters of cells: what ``docs/clusters.md`` shows."""
