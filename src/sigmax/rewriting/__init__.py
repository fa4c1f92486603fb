"""Models rewritten before the engine sees them: a bias as state, fused sensors as one, noises uncorrelated."""
