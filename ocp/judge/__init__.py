"""Judges of a point: audit, certificate and referee, their measures, and the verdict."""
