"""Whether a point is stationary, and how it moves with a parameter."""
