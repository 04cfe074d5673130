"""A bundle: the folder of weights, settings and statistics that inference needs."""
