"""Ways of solving: each a list of legs that are followed one after the other."""
