"""Physical parameters of a system learned from transitions."""
