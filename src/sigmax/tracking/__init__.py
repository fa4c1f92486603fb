"""From plots to tracks: initiation, gating, association, track life, for many targets at once."""
