"""AM: a hopper's next state by its physical parameters, learned, and by a network."""
