"""What trajectories do to bodies: distances, contacts, constraints, and undetermined steps."""
