"""Ways of solving: homotopies of stages, then branches of exact complementarity."""
