"""Learning of policies, and of models for them."""
