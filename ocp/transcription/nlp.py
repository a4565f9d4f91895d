"""A nonlinear program with named blocks, and the way back from its vectors to trajectories."""

from __future__ import annotations

from dataclasses import dataclass, field

import casadi as ca
import numpy as np

from dynamics.contact import Step
from ocp.policy import Policy
from ocp.problem import Problem

_SLIP = 1e3
"""Largest slip in a step, in characteristic distances."""


@dataclass(frozen=True)
class Block:
    """A named array inside a vector: its shape, where it starts, and the names of its last axis."""

    name: str
    shape: tuple[int, ...]
    start: int
    components: tuple[str, ...] = ()

    @property
    def size(self) -> int:
        """Number of entries."""
        return int(np.prod(self.shape))

    @property
    def index(self) -> np.ndarray:
        """Positions in the vector, in the block's shape."""
        return self.start + np.arange(self.size).reshape(self.shape)


class Layout:
    """Blocks laid one after the other in one vector."""

    def __init__(self) -> None:
        self.blocks: dict[str, Block] = {}
        self.size = 0

    def add(self, name: str, shape: tuple[int, ...], components: tuple[str, ...] = ()) -> Block:
        """Append a block; an empty one is kept so that its name is known."""
        block = Block(name, shape, self.size, components)
        self.blocks[name] = block
        self.size += block.size
        return block

    def __contains__(self, name: str) -> bool:
        return name in self.blocks

    def __getitem__(self, name: str) -> Block:
        return self.blocks[name]

    def pack(self, values: dict[str, np.ndarray]) -> np.ndarray:
        """Write blocks into one vector; a block that is not named stays zero."""
        vector = np.zeros(self.size)
        for name, value in values.items():
            block = self.blocks[name]
            vector[block.index] = np.broadcast_to(np.asarray(value, dtype=float), block.shape)
        return vector

    def unpack(self, vector: np.ndarray) -> dict[str, np.ndarray]:
        """Read every block out of a vector."""
        flat = np.asarray(vector, dtype=float).ravel()
        return {name: flat[block.index] for name, block in self.blocks.items()}

    def locate(self, position: int) -> tuple[Block, tuple[int, ...]]:
        """Return the block that holds ``position``, and the index inside it."""
        for block in self.blocks.values():
            if block.start <= position < block.start + block.size:
                return block, tuple(int(i) for i in np.unravel_index(
                    position - block.start, block.shape))  # fmt: skip
        raise IndexError(position)


@dataclass(eq=False)
class NLP:
    """``min f(x, p)`` subject to ``g_lower <= g(x, p) <= g_upper`` and bounds on x.

    The vector x is laid out by ``variables``, g by ``constraints``. The parameter vector p is
    ``values`` (problem and law parameters by name, then ``penalty`` and ``relaxation``, the knobs
    of the strategies for exact complementarity) followed by ``data`` (the initial states of all
    scenarios and the input before the first).

    ``f_g`` maps (x, p) to (f, g); ``gradient`` to (f, df/dx); ``jacobian`` to (g, dg/dx);
    ``hessian`` maps (x, p, lam_f, lam_g) to the upper triangle of the Lagrangian's Hessian.
    ``pairs`` holds the positions of complementary multipliers and gaps in x, shape (2, m);
    ``trajectories`` maps (x, p) to states, inputs, lam and gap where states are no variables,
    ``contacts`` to lam and gap where those are none.
    """

    problem: Problem
    step: Step
    policy: Policy
    method: str
    variables: Layout
    constraints: Layout
    names: list[str]
    data: Layout
    f_g: ca.Function
    gradient: ca.Function
    jacobian: ca.Function
    hessian: ca.Function
    form: str = "product"
    pairs: np.ndarray = field(default_factory=lambda: np.zeros((2, 0), dtype=int))
    trajectories: ca.Function | None = None
    contacts: ca.Function | None = None
    solvers: dict[str, ca.Function] = field(default_factory=dict)

    @property
    def n(self) -> int:
        """Number of variables."""
        return self.variables.size

    @property
    def m(self) -> int:
        """Number of constraints."""
        return self.constraints.size

    def parameter_vector(self, values: dict[str, float]) -> np.ndarray:
        """Put parameter values, by name, and the initial data they imply into the vector p."""
        table = self.problem.parameters
        physical = np.array([values[name] for name in table.names])
        x0 = self.problem.initial_states(physical)
        u_before = np.array(self.problem.limits(physical)[1]).ravel()
        head = np.array([values[name] for name in self.names])
        return np.concatenate([head, self.data.pack({"x0": x0, "u_before": u_before})])

    def products(self, x: np.ndarray, p: np.ndarray) -> np.ndarray:
        """``lam gap`` of every contact and step, flat; shooting methods solve the contacts."""
        if self.pairs.size:
            lam, gap = x[self.pairs]
            return lam * gap
        if self.contacts is None:
            return np.zeros(0)
        lam, gap = (np.array(v).ravel() for v in self.contacts(x, p))
        return lam * gap

    def bounds(self, values: dict[str, float]) -> dict[str, np.ndarray]:
        """Bounds ``lbx ubx lbg ubg`` at the given parameter values."""
        problem = self.problem
        physical = np.array([values[name] for name in problem.parameters.names])
        limits = [np.array(v).ravel() for v in problem.limits(physical)]
        u_lower, u_upper, x_lower, x_upper = limits[2:]
        known = {
            "x": (x_lower, x_upper),
            "u": (u_lower, u_upper),
            "lam": (0.0, self._largest_multipliers()),
            "gap": (0.0, np.inf),
        }
        gain_bound = getattr(self.policy, "bound", np.inf)
        known["x0"] = tuple(np.array(v).ravel() for v in problem.start_limits(physical))
        known["K"] = (-gain_bound, gain_bound)
        lower, upper = {}, {}
        for name in self.variables.blocks:
            lower[name], upper[name] = known.get(name, (-np.inf, np.inf))
        g_lower, g_upper = self._constraint_bounds(physical, known)
        return {
            "lbx": self.variables.pack(lower),
            "ubx": self.variables.pack(upper),
            "lbg": g_lower,
            "ubg": g_upper,
        }

    def sizes(self) -> np.ndarray:
        """Characteristic size of every variable, in its unit, from the problem's reference.

        States and inputs have theirs; an impulse or a gap its own, the two exchanged for a slip
        pair, whose multiplier is a way and whose gap an impulse; gains are inputs over states.
        """
        reference = self.problem.reference
        slips = [pair.kind == "slip" for pair in self.problem.system.pairs] * self.step.branches
        impulse = np.where(slips, reference.gap, reference.impulse)
        gap = np.where(slips, reference.impulse, reference.gap)
        known = {"x": reference.x, "x0": reference.x, "u": reference.u, "k": reference.u,
                 "K": reference.u / reference.x, "lam": impulse, "gap": gap}  # fmt: skip
        return self.variables.pack({name: known[name] for name in self.variables.blocks})

    def _largest_multipliers(self) -> np.ndarray:
        """No bound, but for the slip of a contact: without a normal force nothing else holds it."""
        kinds = [pair.kind for pair in self.problem.system.pairs] * self.step.branches
        far = _SLIP * self.problem.reference.gap
        return np.array([far if kind == "slip" else np.inf for kind in kinds])

    def _constraint_bounds(
        self, physical: np.ndarray, known: dict[str, tuple]
    ) -> tuple[np.ndarray, np.ndarray]:
        lower, upper = {}, {}
        for kind in ("path", "terminal"):
            if kind in self.constraints and self.constraints[kind].size:
                lower[kind], upper[kind] = _evaluated_bounds(self.problem, kind, physical)
        for name in ("x", "u"):
            if f"{name}_bound" in self.constraints:
                lower[f"{name}_bound"], upper[f"{name}_bound"] = known[name]
        if "separation" in self.constraints:
            upper["separation"] = np.inf
        return self.constraints.pack(lower), self.constraints.pack(upper)


def _evaluated_bounds(
    problem: Problem, kind: str, physical: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    constraints = problem.path if kind == "path" else problem.terminal
    ends = []
    for end in ("lower", "upper"):
        columns = [
            ca.repmat(
                ca.SX(getattr(c, end)), c.expression.numel() // ca.SX(getattr(c, end)).numel()
            )
            for c in constraints
        ]
        function = ca.Function(end, [problem.parameters.vector], [ca.vertcat(*columns)])
        ends.append(np.array(function(physical)).ravel())
    return ends[0], ends[1]
