"""Backends of batched evaluation, which tests compare with each other."""

FAST = ["c", "numpy"]
BACKENDS = [*FAST, "casadi"]
