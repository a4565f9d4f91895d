"""Ways to answer a measured state."""
