"""Numbers of a record fitted, and its description written again with what was found."""
