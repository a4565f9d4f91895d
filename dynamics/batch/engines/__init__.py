"""Backends that run the tapes over many samples: compiled C, NumPy, or CasADi itself."""
