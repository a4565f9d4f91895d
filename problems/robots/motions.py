"""Shared parts of problems for tasks of a robot: the symbolic step, running costs, bounds and sizes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import casadi as ca
import numpy as np

from dynamics.systems import ContactSystem, ParameterTable
from ocp.problem.problem import Constraint, FreeStart, Problem, Scaling
from problems.machines.footfalls import FootfallParams
from problems.parameters import Parameters, choice, pose_problem, quantity, structure, table
from problems.robots.robot import Robot


class MotionParams(Parameters):
    """Parameters of a task of a robot from a file."""

    friction: float = quantity(1.0, "1", "factor on the file's coefficients of friction", above=0)
    w_u: float = quantity(0.1, "1/s", "weight of the inputs, as shares of their ranges", least=0)
    w_v: float = quantity(0.01, "s", "weight of the velocities, against swinging", least=0)
    h: float = quantity(0.025, "s", "step size", above=0)
    N: int = structure(40, "number of steps", least=1)
    edges: str = choice(("4", "8"), "number of edges of the friction pyramid in space")


class LegParams(MotionParams, FootfallParams):
    """Parameters of a task on feet, with costs of feet that slide and of feet that are not lifted."""

    w_clear: float = quantity(0.5, "s/m^2", "weight of motion along the ground below the clearance", least=0)


@dataclass(frozen=True, eq=False)
class RobotMotion:
    """A robot's system with the symbols ``p`` of ``params``, and the parts of problems for its tasks."""

    robot: Robot
    params: MotionParams
    p: ParameterTable
    system: ContactSystem

    @classmethod
    def of(cls, name: str, params: MotionParams, robot: Robot) -> RobotMotion:
        """Build the robot's system under a problem's ``name``."""
        p = table(params)
        friction = p["friction"] * robot.coefficients
        edges = int(params.edges)
        return cls(robot, params, p, robot.machine.system(name, p, h=p["h"], friction=friction, edges=edges))

    @property
    def q(self) -> ca.SX:
        """Position (nq, 1)."""
        return self.system.x[: self.robot.machine.tree().nq]

    @property
    def v(self) -> ca.SX:
        """Velocity (nv, 1)."""
        return self.system.x[self.robot.machine.tree().nq :]

    @property
    def effort(self) -> ca.SX:
        """Cost per step of inputs and velocities, ``h (w_u |share|^2 + w_v |v|^2)``.

        The share of an input is its distance from the input that holds the home pose, divided by half its range.
        """
        lower, upper = self.robot.controls.T
        size = np.where(np.isfinite(upper - lower), (upper - lower) / 2, 1.0)
        share = (self.system.u - self.robot.holding_inputs(self.robot.home)) / size
        return self.p["h"] * (self.p["w_u"] * ca.sumsqr(share) + self.p["w_v"] * ca.sumsqr(self.v))

    def posture(self, pose: np.ndarray) -> ca.SX:
        """Return the difference (nq, 1) of q and a pose (nq,), with the entry of forward motion set to zero."""
        error = self.q - pose
        error[self.robot.forward[0]] = 0
        return error

    def stride(self, pose: np.ndarray, speed: ca.SX, stage_cost: ca.SX) -> Problem:
        """Return the problem of a periodic gait at a mean ``speed`` [m/s], near the pose ``pose`` (nq,).

        The first state is free except for forward position and rotation of the root. The last state equals the first,
        except that the root has moved forward by ``speed h N``.
        """
        robot, system, (index, sign) = self.robot, self.system, self.robot.forward
        stride = speed * self.p["h"] * self.params.N
        lower, upper = np.full(system.nx, -np.inf), np.full(system.nx, np.inf)
        for _, entry, _, low, high in robot.machine.tree().limits:
            lower[entry], upper[entry] = low, high
        quaternions = robot.machine.tree().quaternion_entries
        fixed = [index, *quaternions]
        lower[fixed] = upper[fixed] = pose[fixed]
        # Steps preserve the length of a quaternion, so that three of its entries determine the fourth.
        periodic = tuple(i for i in range(system.nx) if i != index and i not in quaternions[::4])
        return self.problem(
            pose,
            stage_cost=stage_cost,
            terminal_cost=ca.SX(0),
            terminal=[Constraint("stride", sign * (self.q[index] - pose[index]) - stride, 0, 0)],
            start=FreeStart(ca.SX(ca.DM(lower)), ca.SX(ca.DM(upper)), periodic),
            guess=partial(_glide, index=index, sign=sign),
        )

    def problem(self, pose: np.ndarray, **parts: Any) -> Problem:
        """Return the problem from rest at the pose ``pose`` (nq,); ``parts`` are further fields of ``Problem``."""
        lower, upper = self.robot.controls.T
        fields = {
            "x0": ca.vertcat(ca.SX(pose), ca.SX.zeros(self.v.numel())),
            "u_lower": lower,
            "u_upper": upper,
            # A contact carries g h m; distances are compared with 0.1 m.
            "scaling": Scaling(impulse=0.25 * self.robot.mass, gap=0.1),
        }
        return pose_problem(self.params, self.system, **{**fields, **parts})


def _glide(problem: Problem, p: np.ndarray, index: int, sign: float) -> tuple[np.ndarray, np.ndarray]:
    """Return a guess that translates the start pose forward at the problem's speed, with zero inputs."""
    X = np.tile(problem.initial_states(p)[0], (problem.N + 1, 1))
    values = problem.parameters.unpack(p)
    X[:, index] += sign * values["speed"] * values["h"] * np.arange(problem.N + 1)
    return X, np.zeros((problem.N, problem.system.nu))
