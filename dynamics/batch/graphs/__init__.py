"""CasADi graphs of functions and rollouts, and the tapes that engines evaluate."""
