"""Model-based policy optimisation; what needs JAX is loaded when a training begins."""
