"""A problem's machine in MuJoCo: the same masses, forces and distances, and its soft contact."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from importlib import import_module
from typing import Any

import casadi as ca
import numpy as np

from dynamics.systems import Machine
from ocp.errors import InputError
from ocp.problem.problem import Problem
from ocp.simulators.mjcf import mjcf

SOLREF, STEP = 0.02, 1e-3
"""Time constant of contacts and joint limits, MuJoCo's default, and its longest step [s]."""
_SAME, _NEAR, _STATES = 1e-9, 1e-5, 3
"""How far numbers may be from ours, relative; distances found by iteration; at how many states."""
_CYLINDER, _BOX, _MESH, _FAR = 5, 6, 7, 1e6


class MujocoWorld:
    """One step of a problem's machine in MuJoCo, at the parameter ``values`` by name.

    The input is held over the problem's step; states beyond (q, v) follow the problem's own
    equations. MuJoCo's M, forces and distances are compared with ours as it is built.

    Raises :class:`~ocp.errors.InputError` without MuJoCo, for a system that was not built from a
    machine, a cost on contact impulses, which it does not know, a shape that MuJoCo has not, and
    where its numbers are not ours.
    """

    def __init__(self, problem: Problem, values: Mapping[str, float]) -> None:
        system, p = problem.system, problem.parameters.vector
        why = "cost or constraints depend on contact impulses" if problem.uses_impulses else ""
        why = "it is not built by the system() of a machine" if system.machine is None else why
        if why or system.machine is None:
            raise InputError(f"{problem.name} cannot be tried in MuJoCo: {why}")
        try:
            self._mujoco: Any = import_module("mujoco")
        except ImportError:
            raise InputError("the world of MuJoCo needs the package mujoco; install 'centralpath[robots]'") from None
        self.problem, self._p = problem, problem.parameters.pack(values)

        def number(value: Any) -> float:
            return float(ca.evalf(ca.substitute(ca.SX(value), p, self._p)))

        rubs = system.forces
        found = () if rubs is None else zip(rubs.names, rubs.friction.elements(), strict=True)
        self.written = mjcf(system.machine, number, {name: number(f) for name, f in found})
        try:
            self.model = self._mujoco.MjModel.from_xml_string(self.written.text)
        except (ValueError, self._mujoco.FatalError) as error:
            why = " ".join(str(error).removeprefix("Error: ").split())
            raise InputError(f"MuJoCo does not take {problem.name}: {why}") from None
        self.data = self._mujoco.MjData(self.model)
        self._q: list[int] = []
        self._v: list[int] = []
        for joint in map(self.model.joint, self.written.joints):
            self._q += range(joint.qposadr[0], joint.qposadr[0] + len(joint.qpos0))
            self._v += np.flatnonzero(self.model.dof_jntid == joint.id).tolist()
        n = len(self._q) + len(self._v)
        then, rows = system.x_next[n:], system.residual[n:]
        left = ca.substitute(rows, then, ca.SX.zeros(then.numel()))
        extra = -ca.solve(ca.jacobian(rows, then), left) if then.numel() else left
        given = [system.x, system.u, system.x_next[:n], p]
        self._extra = ca.Function("extra", given, [ca.densify(extra)])
        self._h = ca.Function("h", [system.x, p], [ca.SX(system.h)])
        self.check()

    def ahead(self, x: np.ndarray, u: np.ndarray, solref: float = SOLREF, step: float = STEP) -> np.ndarray:
        """The state (nx,) a step of the problem after x (nx,) with u (nu,); NaN if it diverges."""
        model, mujoco, h = self.model, self._mujoco, float(self._h(x, self._p))
        count = max(1, math.ceil(h / step - 1e-9))
        model.opt.timestep = h / count
        model.pair_solref[:, 0] = model.jnt_solref[:, 0] = solref
        self._put(x, u)
        # Its own handler of warnings writes a file into the current folder.
        before = mujoco.get_mju_user_warning()
        mujoco.set_mju_user_warning(lambda message: None)
        try:
            mujoco.mj_step(model, self.data, count)
        finally:
            mujoco.set_mju_user_warning(before)
        moved = np.concatenate([self.data.qpos[self._q], self.data.qvel[self._v]])
        if not (abs(moved) < _FAR).all():
            return np.full(x.size, np.nan)
        return np.concatenate([moved, np.array(self._extra(x, u, moved, self._p)).ravel()])

    def check(self) -> None:
        """Compare M, forces and distances at random states with ours.

        Raises :class:`~ocp.errors.InputError` that names what differs, and by how much.
        """
        system, built, data = self.problem.system, self.problem.system.machine, self.data
        assert built is not None
        nq, n = len(self._q), len(self._q) + len(self._v)
        q, v, flat = system.x[:nq], system.x[nq:n], isinstance(built.machine, Machine)
        tree = built.machine.chain() if flat else built.machine.tree()
        near = built.machine.contacts(tree, q, *([built.spheres] if flat else []))
        phis = ca.vertcat(ca.SX(0, 1), *(contact.phi for contact in near.values()))
        pushed = ca.substitute(system.residual[nq:n] / system.h, system.lam, ca.SX.zeros(system.nlam))
        pushed = ca.substitute(pushed, system.x_next, system.x)
        ours = ca.Function(
            "ours",
            [system.x, system.u, self.problem.parameters.vector],
            [tree.mass(q), tree.bias(q, v), ca.densify(phis), pushed],
        )
        rng, full = np.random.default_rng(0), np.zeros((self.model.nv, self.model.nv))
        for _ in range(_STATES):
            x, u = rng.normal(size=system.nx), rng.normal(size=system.nu)
            self._put(x, u)
            x[:nq] = data.qpos[self._q]  # Quaternions have the length 1 there.
            self._mujoco.mj_forward(self.model, data)
            self._mujoco.mj_fullM(self.model, data, full)
            M, bias, phi, _ = (np.array(one) for one in ours(x, u, self._p))
            self._same("the mass matrix", full[np.ix_(self._v, self._v)], M)
            self._same("the bias force", data.qfrc_bias[self._v], bias.ravel())
            self._check_distances(dict(zip(near, phi.ravel(), strict=True)))
            x[nq:n] = 0.0
            self._put(x, u)
            self._mujoco.mj_forward(self.model, data)
            total = (data.qfrc_actuator + data.qfrc_passive - data.qfrc_bias)[self._v]
            self._same("the force at rest", total, -np.array(ours(x, u, self._p)[3]).ravel())

    def _check_distances(self, ours: Mapping[str, float]) -> None:
        for name, pair in self.written.pairs.items():
            one, other = (self.model.geom(geom).id for geom in pair)
            kinds = {int(kind) for kind in self.model.geom_type[[one, other]]}
            iterated = bool(kinds & {_CYLINDER, _MESH}) or kinds == {_BOX}
            # A pair with several points has them by number.
            number = re.compile(re.escape(name) + r"( \d+)?")
            phi = min(phi for label, phi in ours.items() if number.fullmatch(label))
            if phi <= 0 and iterated:
                continue
            theirs = self._mujoco.mj_geomDistance(self.model, self.data, one, other, _FAR, None)
            within = _NEAR if iterated else _SAME
            self._same(f"the distance of {name!r}", np.array(theirs), np.array(phi), within)

    def _same(self, what: str, theirs: np.ndarray, ours: np.ndarray, within: float = _SAME) -> None:
        off = float(abs(theirs - ours).max(initial=0.0))
        if not off <= within * max(1.0, float(abs(ours).max(initial=0.0))):
            raise InputError(
                f"{self.problem.name} is another machine in MuJoCo: {what} differs by {off:.2g};"
                " its system must be that of its machine, with nothing added"
            )

    def _put(self, x: np.ndarray, u: np.ndarray) -> None:
        """Set the state and the input, without any memory of those before."""
        nq, data = len(self._q), self.data
        self._mujoco.mj_resetData(self.model, data)
        data.qpos[self._q], data.qvel[self._v] = x[:nq], x[nq : nq + len(self._v)]
        data.ctrl[:] = u
        self._mujoco.mj_normalizeQuat(self.model, data.qpos)
