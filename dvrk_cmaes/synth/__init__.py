"""Sessions with known truth, drawn from an instrument's meshes: poses, readings, masks and images as a robot has them."""
