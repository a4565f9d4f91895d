"""Named problems and static objectives that need no machine of their own, one a file."""
