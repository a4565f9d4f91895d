"""Machines as tables: links, contact spheres, springs, gears and limits."""
