"""Label images: made from images and clicks, repaired, edited, and turned into meshes."""
