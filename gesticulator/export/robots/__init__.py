"""Motion for machines of metal: joint angles within their limits, for a robot whose model anybody can install."""
