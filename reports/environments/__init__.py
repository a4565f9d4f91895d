"""Learning tasks as Gymnasium environments; importing this package registers them.

``gymnasium.make("centralpath/HalfCheetah-v0", contact="exact")`` makes an environment after
``import reports.environments``; ``gymnasium.make("reports.environments:centralpath/HalfCheetah-v0")``
imports the package itself, since Gymnasium no longer loads entry points of packages.
``gymnasium.make_vec(..., num_envs=64)`` makes many environments that step together.

Raises ``ImportError`` if Gymnasium is not installed.
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
"""Mapping from identifiers of environments to names of tasks."""

for _identifier, _task in ENVIRONMENTS.items():
    register(
        _identifier,
        entry_point="reports.environments.environment:TaskEnv",
        vector_entry_point="reports.environments.environment:TaskVectorEnv",
        kwargs={"task": _task},
    )
