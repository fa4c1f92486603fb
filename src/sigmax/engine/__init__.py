"""Half-steps compiled for this machine or by XLA, and the drivers that repeat them over records and rows."""
