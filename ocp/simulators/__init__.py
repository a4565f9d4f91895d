"""Other simulators, in which plans are replayed: a second opinion beside the referee's."""

SIMULATORS = {"mujoco": "MuJoCo, with its soft contact, at steps of a millisecond"}
"""Simulators by name, with their meaning."""
