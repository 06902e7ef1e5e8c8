"""The surface between two steps: triangles, collisions, topology."""
