"""What a run leaves behind: estimates over time, innovations, covariances, and how they are shown."""
