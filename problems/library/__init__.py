"""Named problems and static objectives without a machine, one per module."""
