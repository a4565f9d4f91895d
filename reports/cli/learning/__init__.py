"""The commands of learned laws: data, and models of them."""
