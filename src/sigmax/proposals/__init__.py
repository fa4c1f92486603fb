"""What the columns of a table may mean: a first description, and doubts about one."""
