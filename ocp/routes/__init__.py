"""Solution routes: homotopies in stages, then branches of exact complementarity."""
