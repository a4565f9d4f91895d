"""Named problems and static objectives without a machine of their own, one per module."""
