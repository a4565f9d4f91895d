"""Legs in MuJoCo: a quadruped stands and trots, an ant walks, and each is pushed once.

``python -m tests.benchmarks.robots.legs`` measures all, rewrites the site's table, and films the trot. Every joint
follows the plan with a spring and a damper at the rate of MuJoCo's steps, on top of the plan's inputs. A walk is the
plan from stand to stand, repeated with short rests in between.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from math import cos, pi, sin
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from docs.generator.measured import write_table
from dynamics.systems.space import SpatialMachine
from ocp import solve
from ocp.simulators.mujoco_world import SOLREF_S, STEP_S, MujocoWorld
from problems.bodies import ant, quadruped
from problems.machines.perspective import PinholeCamera
from problems.machines.spatial import AXES, spatial_shapes
from reports.drawing.shapes import make_cameras
from reports.motion.animation import Motion
from reports.motion.movie import write_animation

PUSH_N_S, PUSH_S = 5.0, 0.01
"""Impulse of a push on the trunk [N s], and its duration [s]."""
DIRECTIONS = 8
DISTANCE_M, LIMIT_S, STAND_S = 2.0, 15.0, 10.0
FILM = Path("docs/pictures/trot-in-mujoco.gif")
FPS = 10


@dataclass(frozen=True)
class Legs:
    """A robot, its standing pose, and the stiffness [N m/rad] and damping [N m s/rad] of its joints' feedback."""

    name: str
    pose: np.ndarray
    stiffness: float
    damping: float
    lowest: float
    rest: float


ROBOTS = (
    Legs("quadruped", quadruped.STANDING, 200.0, 4.0, 0.15, 0.3),
    Legs("ant", ant.standing_pose(), 3000.0, 100.0, 0.0, 0.1),
)


class Walker:
    """A robot in MuJoCo whose joints follow a plan."""

    def __init__(self, legs: Legs) -> None:
        self.legs = legs
        solution = solve(legs.name, "exact", effort="quick")
        self.problem = problem = solution.problem
        self.h = float(solution.values["h"])
        self.x, self.u = solution.arrays["x"][0], solution.arrays["u"][0]
        self.world = MujocoWorld(problem, solution.values)
        machine: Any = problem.system.machine
        model, motors = self.world.model, [body for body in machine.machine.members if body.gear is not None]
        self.gears = np.array([float(body.gear) for body in motors]) * machine.scale
        joints = [model.joint(body.name) for body in motors]
        self.q, self.v = (np.array([joint.qposadr[0] for joint in joints]), np.array([j.dofadr[0] for j in joints]))

    def references(self, walks: bool) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield state and input of the plan at every step of MuJoCo: a walk between rests, or standing."""
        standing, still = np.concatenate([self.legs.pose, np.zeros(self.world.model.nv)]), np.zeros(len(self.gears))
        steps = round(self.problem.N * self.h / STEP_S) if walks else 0
        while True:
            for i in range(steps):
                k, share = divmod(i * STEP_S / self.h, 1.0)
                yield self.x[int(k)] + share * (self.x[int(k) + 1] - self.x[int(k)]), self.u[int(k)]
            for _ in range(round(self.legs.rest / STEP_S)):
                yield standing, still

    def run(self, walks: bool, push: Sequence[float] = (0.0, 0.0), at_s: float = 2.0) -> np.ndarray:
        """Return the states (n, nx) at steps of MuJoCo until a fall, the goal, or the end of the time."""
        world, model, data, nq = self.world, self.world.model, self.world.data, self.world.model.nq
        step = import_module("mujoco").mj_step
        model.opt.timestep, model.pair_solref[:, 0], model.jnt_solref[:, 0] = STEP_S, SOLREF_S, SOLREF_S
        world._set_state(np.concatenate([self.legs.pose, np.zeros(model.nv)]), np.zeros(len(self.gears)))
        states = list[np.ndarray]()
        times = np.arange(0.0, LIMIT_S if walks else STAND_S, STEP_S)
        for t, (x, u) in zip(times, self.references(walks), strict=False):
            error = self.legs.stiffness * (x[self.q] - data.qpos[self.q])
            error += self.legs.damping * (x[nq + self.v] - data.qvel[self.v])
            data.ctrl[:] = np.clip(u + error / self.gears, -1.0, 1.0)
            data.xfrc_applied[1, :2] = np.array(push) / PUSH_S * (at_s <= t < at_s + PUSH_S)
            step(model, data)
            states.append(np.concatenate([data.qpos, data.qvel]))
            if data.qpos[2] < self.legs.lowest or (walks and data.qpos[0] >= DISTANCE_M):
                break
        return np.array(states)

    def arrived(self, walks: bool, states: np.ndarray) -> bool:
        """Return whether a run reached its goal upright."""
        ends = states[-1, 0] >= DISTANCE_M if walks else len(states) * STEP_S >= STAND_S - STEP_S
        upright = 1 - 2 * (states[-1, 4] ** 2 + states[-1, 5] ** 2) > 0.5
        return bool(ends and upright and states[-1, 2] >= self.legs.lowest)


def row(walker: Walker, walks: bool) -> list[str]:
    """Return robot, task, result without a push, and how many pushes it survives."""
    states = walker.run(walks)
    seconds = f"{len(states) * STEP_S:.1f} s" if walker.arrived(walks, states) else "falls"
    angles = [2 * pi * i / DIRECTIONS for i in range(DIRECTIONS)]
    pushed = [walker.run(walks, (PUSH_N_S * cos(a), PUSH_N_S * sin(a))) for a in angles]
    survived = sum(walker.arrived(walks, run) for run in pushed)
    task = f"{'walks' if walks else 'stands'}, {f'{DISTANCE_M:g} m' if walks else f'{STAND_S:g} s'}"
    weight = walker.world.model.body_mass.sum()
    cells = [walker.legs.name, task, seconds, f"{survived} of {DIRECTIONS}", f"{PUSH_N_S / weight:.2g}"]
    print(*cells, *(f"({run[-1, 0]:.2f}, {run[-1, 1]:.2f})" for run in pushed), flush=True)
    return cells


def film(machine: SpatialMachine, states: np.ndarray, file: Path) -> None:
    """Write a film of states (n, nx) at steps of MuJoCo."""
    shown = states[:: round(1 / FPS / STEP_S)]
    camera = PinholeCamera.around((DISTANCE_M / 2, 0.0, 0.2), 0.75 * DISTANCE_M)
    shapes = [spatial_shapes(machine, camera, state) for state in shown]
    motion = Motion("in MuJoCo; pushed sideways by 5 N s after 2 s", "", shown, shapes, [[] for _ in shown], None)
    animation: Any = SimpleNamespace(
        title="The quadruped trots 2 m",
        motions=[motion],
        cameras=make_cameras([shapes]),
        axes=AXES,
        largest=0.0,
        unit="",
        rough=False,
        cones=False,
        fps=FPS,
        speed=1.0,
        times=np.arange(len(shown)) / FPS,
        clock=lambda frame: f"t = {frame / FPS:.2f} s",
    )
    write_animation(animation, file)


def main() -> None:
    """Measure all robots, write the table and the film."""
    rows = []
    for legs in ROBOTS:
        walker = Walker(legs)
        rows += [row(walker, walks) for walks in (False, True)]
        if legs.name == "quadruped":
            film(quadruped.quadruped(), walker.run(True, (0.0, PUSH_N_S)), FILM)
    write_table(
        "legs-in-mujoco",
        title="Legs in MuJoCo",
        command="python -m tests.benchmarks.robots.legs",
        columns=["robot", "task", "without a push", "pushed", "push [m/s]"],
        rows=rows,
        note=f"*Pushed*: how many pushes of {PUSH_N_S:g} N s after 2 s, in {DIRECTIONS} directions around, end upright"
        f" at the goal, within {LIMIT_S:g} s. *Push*: over the mass of the robot. Joints follow the plan at 1 kHz, with"
        + " and ".join(f" {r.stiffness:g} N m/rad and {r.damping:g} N m s/rad ({r.name})" for r in ROBOTS)
        + "; nothing knows where the trunk is.",
    )


if __name__ == "__main__":
    main()
