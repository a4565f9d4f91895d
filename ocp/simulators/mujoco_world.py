"""A problem's machine in MuJoCo: the same masses, forces and distances, but MuJoCo's soft contact."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np

from ocp.errors import InputError
from ocp.problem.problem import Problem
from ocp.simulators.mjcf import write_mjcf
from ocp.simulators.mujoco_rollouts import load_model

SOLREF_S = 0.02
"""Time constant of contacts and joint limits [s], MuJoCo's default."""
STEP_S = 1e-3
"""Longest step of MuJoCo [s]."""
SERVO_SHARE = 0.25
"""Time constant of servos of massless bodies, over the step: they lag by half a step, as tips that move evenly."""
RELATIVE_TOLERANCE = 1e-9
"""Largest relative difference between MuJoCo's values and the problem's."""
ITERATED_TOLERANCE = 1e-5
"""Largest relative difference between distances, for distances that MuJoCo computes by iteration."""
N_COMPARED_STATES = 3
"""Number of random states at which the two models are compared."""
GEOM_CYLINDER = 5
"""MuJoCo's type number of cylinders."""
GEOM_BOX = 6
"""MuJoCo's type number of boxes."""
GEOM_MESH = 7
"""MuJoCo's type number of meshes."""
DIVERGED = 1e6
"""Absolute value of a state from which a motion has diverged."""


class MujocoWorld:
    """A problem's machine in MuJoCo, at ``values``, a mapping from parameters to numbers.

    The input is held over the problem's step; states other than (q, v) follow the problem's
    equations. A massless body on slides with servos, as a fingertip, gets the mass of servos that lag by half
    of the problem's first step. MuJoCo's M, forces and distances are compared with the problem's at construction.

    Raises :class:`~ocp.errors.InputError` if MuJoCo is not installed, for a system that was not built from a machine,
    a cost on contact impulses or a shape that MuJoCo does not have, and if MuJoCo's values differ from the problem's.
    """

    def __init__(self, problem: Problem, values: Mapping[str, float]) -> None:
        system, p = problem.system, problem.parameters.vector
        obstacle = "cost or constraints depend on contact impulses" if problem.uses_impulses else ""
        obstacle = "it is not built by the system() of a machine" if system.machine is None else obstacle
        if obstacle or system.machine is None:
            raise InputError(f"{problem.name} cannot be tried in MuJoCo: {obstacle}")
        self.problem, self._p = problem, problem.parameters.pack(values)

        def number(value: Any) -> float:
            return float(ca.evalf(ca.substitute(ca.SX(value), p, self._p)))

        forces = system.forces
        frictions = () if forces is None else zip(forces.names, forces.friction.elements(), strict=True)
        self._h = ca.Function("h", [system.x, p], [ca.SX(system.h)])
        servo_time = SERVO_SHARE * float(self._h(problem.initial_states(self._p)[0], self._p))
        self.mjcf = write_mjcf(system.machine, number, {name: number(f) for name, f in frictions}, servo_time)
        self._mujoco, self.model = load_model(self.mjcf.text, problem.name)
        self.data, self.version = self._mujoco.MjData(self.model), self._mujoco.__version__
        self._q: list[int] = []
        self._v: list[int] = []
        for joint in map(self.model.joint, self.mjcf.joints):
            self._q += range(joint.qposadr[0], joint.qposadr[0] + len(joint.qpos0))
            self._v += np.flatnonzero(self.model.dof_jntid == joint.id).tolist()
        n = len(self._q) + len(self._v)
        further_states, equations = system.x_next[n:], system.residual[n:]
        remainder = ca.substitute(equations, further_states, ca.SX.zeros(further_states.numel()))
        solution = -ca.solve(ca.jacobian(equations, further_states), remainder) if further_states.numel() else remainder
        arguments = [system.x, system.u, system.x_next[:n], p]
        self._further_states = ca.Function("extra", arguments, [ca.densify(solution)])
        self.check()

    def step(self, x: np.ndarray, u: np.ndarray, solref: float = SOLREF_S, step: float = STEP_S) -> np.ndarray:
        """Return the state (nx,) one step of the problem after x (nx,) with u (nu,); NaN if it diverges."""
        model, mujoco, h = self.model, self._mujoco, float(self._h(x, self._p))
        count = max(1, math.ceil(h / step - 1e-9))
        model.opt.timestep = h / count
        model.pair_solref[:, 0] = model.jnt_solref[:, 0] = solref
        self._set_state(x, u)
        # MuJoCo's default handler of warnings writes a file into the current folder.
        previous_handler = mujoco.get_mju_user_warning()
        mujoco.set_mju_user_warning(lambda message: None)
        try:
            mujoco.mj_step(model, self.data, count)
        finally:
            mujoco.set_mju_user_warning(previous_handler)
        reached = np.concatenate([self.data.qpos[self._q], self.data.qvel[self._v]])
        if not (abs(reached) < DIVERGED).all():
            return np.full(x.size, np.nan)
        return np.concatenate([reached, np.array(self._further_states(x, u, reached, self._p)).ravel()])

    def check(self) -> None:
        """Compare MuJoCo's M, forces and distances at random states with the problem's.

        Raises :class:`~ocp.errors.InputError`, with the quantity that differs in its message.
        """
        system, mechanism, data = self.problem.system, self.problem.system.machine, self.data
        assert mechanism is not None
        nq, n = len(self._q), len(self._q) + len(self._v)
        q, v, tree = system.x[:nq], system.x[nq:n], mechanism.machine.tree()
        contacts = mechanism.machine.contacts(q, mechanism.spheres)
        phis = ca.vertcat(ca.SX(0, 1), *(contact.phi for contact in contacts.values()))
        forces = ca.substitute(system.residual[nq:n] / system.h, system.lam, ca.SX.zeros(system.nlam))
        forces = ca.substitute(forces, system.x_next, system.x)
        ours = ca.Function(
            "ours",
            [system.x, system.u, self.problem.parameters.vector],
            [tree.mass(q), tree.bias(q, v), ca.densify(phis), forces],
        )
        rng, full = np.random.default_rng(0), np.zeros((self.model.nv, self.model.nv))
        servo_mass = np.zeros(self.model.nv)
        for name, m in self.mjcf.servo_masses.items():
            servo_mass[self.model.joint(name).dofadr[0]] = m
        for _ in range(N_COMPARED_STATES):
            x, u = rng.normal(size=system.nx), rng.normal(size=system.nu)
            self._set_state(x, u)
            x[:nq] = data.qpos[self._q]  # Quaternions have length 1 in this state.
            self._mujoco.mj_forward(self.model, data)
            self._mujoco.mj_fullM(self.model, data, full)
            M, bias, phi, _ = (np.array(matrix) for matrix in ours(x, u, self._p))
            self._check_equal("the mass matrix", full[np.ix_(self._v, self._v)], M + np.diag(servo_mass[self._v]))
            self._check_equal("the bias force", (data.qfrc_bias - data.qfrc_gravcomp)[self._v], bias.ravel())
            self._check_distances(dict(zip(contacts, phi.ravel(), strict=True)))
            x[nq:n] = 0.0
            self._set_state(x, u)
            self._mujoco.mj_forward(self.model, data)
            total = (data.qfrc_actuator + data.qfrc_passive - data.qfrc_bias)[self._v]
            self._check_equal("the force at rest", total, -np.array(ours(x, u, self._p)[3]).ravel())

    def _check_distances(self, ours: Mapping[str, float]) -> None:
        for name, pair in self.mjcf.pairs.items():
            first_geom, second_geom = (self.model.geom(geom).id for geom in pair)
            kinds = {int(kind) for kind in self.model.geom_type[[first_geom, second_geom]]}
            by_iteration = bool(kinds & {GEOM_CYLINDER, GEOM_MESH}) or kinds == {GEOM_BOX}
            # The points of a pair are numbered.
            number = re.compile(re.escape(name) + r"( \d+)?")
            phi = min(phi for label, phi in ours.items() if number.fullmatch(label))
            if phi <= 0 and by_iteration:
                continue
            distance = self._mujoco.mj_geomDistance(self.model, self.data, first_geom, second_geom, DIVERGED, None)
            tolerance = ITERATED_TOLERANCE if by_iteration else RELATIVE_TOLERANCE
            self._check_equal(f"the distance of {name!r}", np.array(distance), np.array(phi), tolerance)

    def _check_equal(
        self, quantity: str, theirs: np.ndarray, ours: np.ndarray, tolerance: float = RELATIVE_TOLERANCE
    ) -> None:
        difference = float(abs(theirs - ours).max(initial=0.0))
        if not difference <= tolerance * max(1.0, float(abs(ours).max(initial=0.0))):
            raise InputError(
                f"{self.problem.name} is another machine in MuJoCo: {quantity} differs by {difference:.2g};"
                " its system must be that of its machine, with nothing added"
            )

    def _set_state(self, x: np.ndarray, u: np.ndarray) -> None:
        """Set the state and the input, and reset all other data."""
        nq, data = len(self._q), self.data
        self._mujoco.mj_resetData(self.model, data)
        data.qpos[self._q], data.qvel[self._v] = x[:nq], x[nq : nq + len(self._v)]
        data.ctrl[:] = u
        self._mujoco.mj_normalizeQuat(self.model, data.qpos)
