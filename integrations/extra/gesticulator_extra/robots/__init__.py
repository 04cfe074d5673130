"""Motion for robots: joint angles within the limits of a Unitree G1."""
