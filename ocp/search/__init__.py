"""Plans found from nothing: a tree over pushes, each plan solved on its own branch."""
