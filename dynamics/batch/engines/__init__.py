"""What runs the tapes over many samples: compiled C, NumPy, or CasADi itself."""
