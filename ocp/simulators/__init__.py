"""Other simulators than ours, in which plans are tried: a second opinion, never the referee's."""

WORLDS = {"mujoco": "MuJoCo, with its soft contact, at steps of a millisecond"}
