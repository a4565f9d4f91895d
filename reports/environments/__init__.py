"""The tasks as Gymnasium environments; importing this registers them.

``gymnasium.make("centralpath/HalfCheetah-v0", contact="exact")`` makes one after
``import reports.environments``, or by itself as
``gymnasium.make("reports.environments:centralpath/HalfCheetah-v0")``: Gymnasium looks packages'
entry points up no longer. ``gymnasium.make_vec(..., num_envs=64)`` makes many that step together.

Raises ``ImportError`` where Gymnasium is not installed.
"""

try:
    from gymnasium.envs.registration import register
except ImportError as missing:
    raise ImportError(
        "environments need Gymnasium, which is not installed; pip install 'centralpath[gym]'"
    ) from missing

ENVIRONMENTS = {
    "centralpath/BallThrow-v0": "ball-throw",
    "centralpath/Hopper-v0": "hopper",
    "centralpath/HalfCheetah-v0": "half-cheetah",
}
"""Identifiers of the environments, and the tasks that they are."""

for _identifier, _task in ENVIRONMENTS.items():
    register(
        _identifier,
        entry_point="reports.environments.environment:TaskEnv",
        vector_entry_point="reports.environments.environment:TaskVectorEnv",
        kwargs={"task": _task},
    )
