"""Judges of a point: audit, certificate and referee, what they measure, and the verdict."""
