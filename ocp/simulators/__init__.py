"""Replays of plans in other simulators: a second opinion in addition to the referee's."""

SIMULATORS = {"mujoco": "MuJoCo, with its soft contact, at steps of a millisecond"}
"""Mapping from the name of a simulator to its description."""
