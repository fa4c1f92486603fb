"""A filter at the end of a live sensor: measurements as they come, also late ones and those of other stations."""
