"""N3: which smoothing to trust, by what its plans cost under the exact law."""
