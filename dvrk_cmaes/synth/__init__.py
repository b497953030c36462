"""Synthetic sessions with known true poses: poses, joint readings, masks and images, rendered from meshes."""
