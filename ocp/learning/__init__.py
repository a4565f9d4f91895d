"""Learning of policies, and of the physical parameters and models that they are learned with."""
