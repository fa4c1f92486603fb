"""What a model consists of: functions, noises, names and spaces, prior, bias, modes, constraints."""
