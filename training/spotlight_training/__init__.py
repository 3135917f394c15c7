"""Data and training of the embedded backbone: rendering, networks, objectives."""
