"""Searches for plans beyond the usual route: by pushes, by samples, by other routes, near a user's guess."""
