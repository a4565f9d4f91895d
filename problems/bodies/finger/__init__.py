"""A finger of two links beside a disc on a pin: the machine and its two problems."""
