"""A result as a table, a picture or a few lines: names, units and arrays, whatever made them."""
