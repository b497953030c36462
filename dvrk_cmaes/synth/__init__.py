"""Sessions with known truth, drawn from meshes: poses, readings, masks and images as a robot has them."""
