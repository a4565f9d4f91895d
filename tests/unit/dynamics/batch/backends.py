"""The backends of batched evaluation: those that the tests hold against each other."""

FAST = ["c", "numpy"]
BACKENDS = [*FAST, "casadi"]
