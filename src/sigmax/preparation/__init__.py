"""What a user gives to a run: checked before any long work and laid out for the engine."""
