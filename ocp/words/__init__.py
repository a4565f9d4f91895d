"""What a person or a file writes, as the values that are meant: numbers, types, paths."""
