"""What a description becomes: motion, sensors, noises, prior, places on the Earth, trials."""
