"""The tasks in closed loop: problem, starts, disturbance, and outcome."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

import problems
from ocp.mpc.plants import Disturbance
from ocp.mpc.simulate import Goals
from ocp.problem.problem import Problem

SKIP, BALANCED = 10, (0.35, 0.1)
"""Samples of each run that are not timed; largest position [m] and angle [rad] of a balanced pole."""
NEAR = 0.01
"""Largest distance [m] of a pushed body from its goal at the end."""
TURN = 2.0
"""Least angle [rad] by which the spinner must turn."""
LOWEST, UPRIGHT = 0.2, 0.9
"""Lowest height [m] of a standing trunk at any sample, and least cosine of its tilt at the end."""
PUSH = 0.3
"""Change of the trunk's velocity by a push [m/s]."""


Outcome = Callable[[np.ndarray], np.ndarray]
"""Function from a loop's trajectories x (S, T+1, nx) to whether each succeeds; diverged ones end in NaN."""


@dataclass(frozen=True)
class Task:
    """One row of the table: ``floor`` is the largest p99 [s], ``outcome`` is required at the end, for a
    share ``needed`` of the starts and for the first, the problem's own.

    ``spread`` is half the width of the box around the problem's start from which others are drawn;
    ``against`` is a phase that runs the first ``compared`` starts for a comparison of costs.
    """

    name: str
    problem: str
    floor: float
    steps: int
    starts: int
    spread: tuple[float, ...]
    outcome: Outcome
    says: str
    parameters: dict[str, float] = field(default_factory=dict)
    goals: Goals | None = None
    noise: dict[str, float] = field(default_factory=dict)
    trust: float = 1.0
    """Trust of the controller in a measurement."""
    iterations: int = 1
    """Quadratic programs per sample."""
    needed: float = 1.0
    """Share of the starts for which the outcome is required."""
    came: Outcome | None = None
    """Reported in addition to the outcome: whether it was reached at some sample."""
    certify: int = 20
    """Every plan of so many is judged; 0 for none."""
    plant: str = "exact"
    pushes: dict[int, np.ndarray] = field(default_factory=dict)
    """Changes of the state before samples."""
    against: str = ""
    compared: int = 1
    ratio: float = np.inf
    """Largest closed-loop cost relative to that of ``against``."""
    peer: int = 0
    """Samples of the plain loop; 0 for none."""
    published: str = ""

    def made(self) -> Problem:
        """Return the problem."""
        return problems.get(self.problem, **self.parameters)

    def drawn(self, start: np.ndarray) -> np.ndarray:
        """Return the given start and random ones around it, (starts, nx)."""
        off = np.random.default_rng(0).uniform(-1, 1, (self.starts, start.size))
        off[0] = 0.0
        wide = np.zeros(start.size)
        wide[: len(self.spread)] = self.spread
        return start + off * wide

    @property
    def disturbance(self) -> Disturbance:
        """Noise of the measurement, and pushes."""
        return Disturbance(noise_state=self.noise, pushes=self.pushes)


def balanced(x: np.ndarray) -> np.ndarray:
    """Return whether cart and pole are within :data:`BALANCED` at the end, by start."""
    return (np.abs(x[:, -1, :2]) <= BALANCED).all(axis=1)


def turned(x: np.ndarray) -> np.ndarray:
    """Return whether the spinner was turned by :data:`TURN`."""
    return x[:, -1, 2] >= TURN


def back(x: np.ndarray) -> np.ndarray:
    """Return whether the hopper is half a metre further back, its torso at most 0.2 m lower."""
    return (x[:, -1, 0] <= x[:, 0, 0] - 0.5) & (x[:, -1, 1] > x[:, 0, 1] - 0.2)


def stands(x: np.ndarray) -> np.ndarray:
    """Return whether the quadruped's trunk was never below :data:`LOWEST`, and ends upright."""
    upright = 1 - 2 * np.sum(x[:, -1, 4:6] ** 2, axis=1) >= UPRIGHT
    return (x[:, :, 2] >= LOWEST).all(axis=1) & upright


def around(every: int, count: int) -> dict[int, np.ndarray]:
    """Return pushes of the quadruped's trunk, one in so many samples, sideways, forward, to the other side, back."""
    angles = np.pi / 2 * (1 - np.arange(count))
    velocities = PUSH * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return {every * (k + 1): np.concatenate([np.zeros(19), v, np.zeros(16)]) for k, v in enumerate(velocities)}


def at(*goal: float, end: bool = True, first: int = 0) -> Outcome:
    """Return the outcome that the body is within :data:`NEAR` of a goal, at the end or at any sample.

    ``first`` is the index of the body's place in the state.
    """

    def found(x: np.ndarray) -> np.ndarray:
        near = np.linalg.norm(x[:, :, first : first + len(goal)] - goal, axis=2) <= NEAR
        return near[:, -1] if end else near.any(axis=1)

    return found


def follows(x: np.ndarray) -> np.ndarray:
    """Return whether the disc is within 0.1 rad of every goal when the next one comes."""
    ends = np.arange(1, x.shape[1] // 25 + 1) * 25
    goals = [staircase(k - 1)["goal"] for k in ends]
    return (np.abs(x[:, ends, 2] - goals) <= 0.1).all(axis=1)


def from_present(of: int, nominal: int) -> Goals:
    """Return goals whose nominal motion starts, at every sample, at a coordinate's present value."""
    return lambda _, x: {"lead": float(x[of] - x[nominal])}


def staircase(k: int, _: object = None) -> dict[str, float]:
    """Return the goal of the disc's angle at a sample; each is kept for 25 samples."""
    return {"goal": math.pi / 4 * (1, 2, 1, 0)[k // 25 % 4]}


def _walls(N: int, floor: float, published: str) -> Task:
    return Task(
        f"soft-walls N = {N}",
        "soft-walls",
        floor,
        200,
        106,
        (0.03, 0.06, 0.15, 0.15),
        balanced,
        "balanced",
        {"N": N},
        needed=0.95,
        certify=100,
        peer=1010,
        published=published,
    )


_PLACES = dict.fromkeys(("ox", "oy", "ax", "ay"), 0.01)

TASKS = {
    task.name: task
    for task in (
        _walls(5, 0.5e-3, "C3 100 Hz"),
        _walls(20, 1e-3, ""),
        Task(
            "spinner",
            "spinner",
            4e-3,
            100,
            12,
            (0.05, 0.05),
            turned,
            f"turned {TURN:g} rad",
            goals=from_present(2, 6),
            against="relaxed",
            compared=12,
            ratio=1.0,
            peer=110,
            published="IDTO 200 Hz",
        ),
        Task(
            "finger-disc",
            "finger-disc",
            3e-3,
            100,
            12,
            (0, 0, 0, 0.2, 0.2),
            follows,
            "follows",
            goals=staircase,
            iterations=3,
            against="full",
            ratio=1.05,
            peer=110,
        ),
        Task(
            "idto-hopper",
            "idto-hopper",
            5e-3,
            100,
            12,
            (0, 0, 0, 0, 0, 0.05),
            back,
            "back 0.5 m",
            goals=from_present(0, 10),
            peer=60,
            published="IDTO 100 Hz",
        ),
        Task(
            "push-disc",
            "push-disc",
            1.5e-3,
            60,
            20,
            (0.1, 0.1, 0.1, 0.1),
            at(1.0, 0.5),
            "ends within 1 cm",
            came=at(1.0, 0.5, end=False),
            trust=0.3,
            noise=_PLACES,
            certify=10,
            peer=300,
        ),
        Task(
            "planar-push",
            "planar-push",
            2.5e-3,
            60,
            20,
            (0.03, 0.03, 0.1, 0.03, 0.03),
            at(0.5, 1.0),
            "ends within 1 cm",
            {"w_end": 1000.0},
            trust=0.3,
            came=at(0.5, 1.0, end=False),
            noise=_PLACES,
            certify=10,
            peer=300,
        ),
        Task(
            "finger-box",
            str(Path(__file__).with_name("finger_box.py")),
            5e-3,
            75,
            20,
            (0.05, 0.05, 0.005, 0.02, 0.1),
            at(0.1, 0.03, first=2),
            "ends within 1 cm",
            {"goal_z": 0.03},
            trust=0.3,
            came=at(0.1, 0.03, end=False, first=2),
            noise=dict.fromkeys(("box_x", "box_z"), 0.002),
            certify=15,
            peer=300,
        ),
        Task(
            "quadruped",
            "quadruped",
            25e-3,
            333,
            4,
            (0,) * 19 + (0.1, 0.1),
            stands,
            "stands 10 s",
            {"distance": 0.0, "w_joints": 3.0},
            plant="mujoco",
            pushes=around(60, 5),
            certify=0,
        ),
    )
}
