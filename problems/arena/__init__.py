"""Public tasks of other programs, as problems with their published instances and results."""
