"""Searches for plans in addition to the usual route: by pushes, by samples, by other routes, near a user's guess."""
