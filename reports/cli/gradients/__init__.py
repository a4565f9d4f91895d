"""Command that judges the gradients of simulators."""
