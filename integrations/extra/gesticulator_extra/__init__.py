"""Side tools of gesticulator: a Unitree G1 robot, submissions to leaderboards, and a search for settings."""
