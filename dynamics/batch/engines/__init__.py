"""Engines that evaluate tapes for many samples with compiled C, NumPy or CasADi."""
