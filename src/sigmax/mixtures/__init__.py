"""Several beliefs at once: the modes of a model that switches, the members of a bank."""
