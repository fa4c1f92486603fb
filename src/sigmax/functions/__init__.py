"""The functions of a model: what they read and give, found by calling and tracing them before a run."""
