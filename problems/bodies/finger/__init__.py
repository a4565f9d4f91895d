"""A finger of two links next to a disc on a pin: the machine and its two problems."""
