"""Machines in the plane: links, chains, and their equations of motion."""
