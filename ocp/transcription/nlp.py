"""A nonlinear program with named blocks, and the conversion of its vectors to trajectories."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Self

import casadi as ca
import numpy as np

from dynamics.contact import Step
from ocp.problem.evaluation import Evaluation, at_steps
from ocp.problem.policy import Policy
from ocp.problem.problem import Problem, Scales
from ocp.problem.rollout import Gains
from ocp.problem.sketch import Window
from ocp.programs.layout import Layout
from ocp.programs.program import PENALTY, RELAXATION, Functions, PairName, Program
from ocp.programs.solver import Result
from ocp.programs.units import Scale, measure_scale, row_scaled
from ocp.transcription.stage import COMPARISONS, ROUNDABLE, Stage

if TYPE_CHECKING:
    import scipy.sparse as sp

    from ocp.transcription.common import Graph


_SLIP = 1e3
"""Maximum slip in a step, in characteristic distances."""


@dataclass(eq=False)
class NLP(Program):
    """The nonlinear program of a transcribed optimal control problem.

    The parameter vector p contains the parameters called ``names`` (of problem and law, then ``penalty`` and
    ``relaxation`` of the strategies for exact complementarity), followed by ``data`` (the initial states of all
    scenarios and the input before the first step).

    ``trajectories`` maps (x, p) to states, inputs, lam and gap if states are not variables; ``contacts`` maps (x, p)
    to lam and gap if these are not variables. ``windows`` maps blocks of variables to narrower bounds, lower and
    upper. ``stages`` are the parts of the program.
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
    reformulation: str = "product"
    pairs: np.ndarray = field(default_factory=lambda: np.zeros((2, 0), dtype=int))
    trajectories: ca.Function | None = None
    contacts: ca.Function | None = None
    solvers: dict[str, Any] = field(default_factory=dict)
    windows: dict[str, Window] = field(default_factory=dict)
    stages: list[Stage] = field(default_factory=list)

    @classmethod
    def of(
        cls, graph: Graph, method: str, variables: Layout, constraints: Layout, functions: Functions, **fields: Any
    ) -> Self:
        """Build the program of a transcribed graph from its layouts and functions."""
        parts = (graph.problem, graph.step, graph.policy, method, variables, constraints, graph.names, graph.data())
        return cls(*parts, *functions, **fields)

    @property
    def title(self) -> str:
        """Name of the problem."""
        return self.problem.name

    def parameter_vector(self, values: dict[str, float]) -> np.ndarray:
        """Return the vector p: the parameters ``values`` and the initial data computed from them."""
        evaluation = Evaluation(self.problem, values)
        start = {"x0": evaluation.initial_states, "u_before": evaluation.limits.u_before}
        return np.concatenate([[values[name] for name in self.names], self.data.pack(start)])

    def constant(self, p: np.ndarray) -> float:
        """Return the problem's constant cost, see :attr:`~ocp.problem.evaluation.Evaluation.constant_cost`."""
        return Evaluation(self.problem, dict(zip(self.names, p, strict=False))).constant_cost

    def products(self, x: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Return ``lam gap`` of every contact and step, as a flat array; in shooting, of the solved contacts."""
        if self.contacts is None:
            return super().products(x, p)
        lam, gap = (np.array(v).ravel() for v in self.contacts(x, p))
        return lam * gap

    def kink_margins(self, x: np.ndarray, values: dict[str, float]) -> tuple[np.ndarray, np.ndarray]:
        """Return the margins of all kinks at a point, and their changes, see :mod:`ocp.transcription.kinks`."""
        parameters, data = np.split(NLP.parameter_vector(self, values), [len(self.names)])
        source, sizes = np.concatenate([x, data]), np.concatenate([self.sizes(x), np.zeros(data.size)])
        margins = [np.zeros((0, 2))]
        for stage, function in self._margin_functions:
            outputs = function.map(stage.copies)(source[stage.index].T, parameters, sizes[stage.index].T)
            margins.append(np.stack([np.array(output).T.ravel() for output in outputs], axis=1))
        values_and_changes = np.concatenate(margins)
        return values_and_changes[:, 0], values_and_changes[:, 1]

    @cached_property
    def _margin_functions(self) -> list[tuple[Stage, ca.Function]]:
        kinked = [stage for stage in self.stages if stage.operations & (COMPARISONS | ROUNDABLE)]
        if not kinked:
            return []
        # Imported here, since most problems have no kinks.
        from ocp.transcription.kinks import margin_function

        return [(stage, margin_function(stage)) for stage in kinked]

    def is_near_kink(self, x: np.ndarray, values: dict[str, float], reach: float) -> bool:
        """Return whether a point is within ``reach`` of a kink, in changes of its margin."""
        margins, changes = self.kink_margins(x, values)
        return bool(np.any(np.abs(margins) < reach * changes))

    def bounds(self, values: dict[str, float]) -> dict[str, np.ndarray]:
        """Return the bounds ``lbx ubx lbg ubg`` at the given parameter values."""
        problem, evaluation = self.problem, Evaluation(self.problem, values)
        _, _, u_lower, u_upper, x_lower, x_upper = evaluation.limits
        # Without a normal force nothing else bounds the slip of a contact.
        slip_limits = {"slip": _SLIP * problem.scales.gap}
        lam_upper = [slip_limits.get(pair.kind, np.inf) for pair in problem.system.pairs] * self.step.branches
        block_bounds = {
            "x": (x_lower, x_upper),
            "u": (u_lower, u_upper),
            "lam": (0.0, np.array(lam_upper)),
            "gap": (0.0, np.inf),
        }
        gain_bound = getattr(self.policy, "bound", np.inf)
        block_bounds["x0"] = evaluation.start_limits
        block_bounds["K"] = (-gain_bound, gain_bound)
        lower, upper = {}, {}
        for name in self.variables.blocks:
            lower[name], upper[name] = block_bounds.get(name, (-np.inf, np.inf))
            if name in self.windows:
                lowest, highest = self.windows[name]
                lower[name], upper[name] = np.fmax(lower[name], lowest), np.fmin(upper[name], highest)
        g_lower, g_upper = self._constraint_bounds(evaluation.p, block_bounds)
        return {"lbx": self.variables.pack(lower), "ubx": self.variables.pack(upper), "lbg": g_lower, "ubg": g_upper}

    def sizes(self, x: np.ndarray) -> np.ndarray:
        """Return the characteristic size (n,) of every variable, in its unit, from the problem's scaling.

        Multipliers have the size of an impulse and gaps the size of a distance; the two are exchanged for slip pairs,
        whose multiplier is a distance and whose gap an impulse. Gains are inputs over states.
        """
        sizes = self.problem.natural_scales
        slips = self._slips
        impulse = np.where(slips, sizes.gap, sizes.impulse)
        gap = np.where(slips, sizes.impulse, sizes.gap)
        return self._pack_sizes(sizes, impulse, gap) * self.natural.x

    def _pack_sizes(self, sizes: Scales, lam: np.ndarray, gap: np.ndarray) -> np.ndarray:
        """Return sizes of all variables (n,), given the sizes of states, inputs, multipliers and gaps."""
        x, u = sizes.x, sizes.u
        blocks = {"x": x, "x0": x, "u": u, "k": u, "K": u[:, None] / x, "lam": lam, "gap": gap}
        return self.variables.pack({name: blocks[name] for name in self.variables.blocks})

    @property
    def _slips(self) -> np.ndarray:
        """Mask (n,) of the pairs whose multiplier is a distance and whose gap is an impulse."""
        return np.array([p.kind == "slip" for p in self.problem.system.pairs] * self.step.branches)

    @cached_property
    def scale(self) -> Scale | None:
        """Units of variables, constraints and cost for a solver; None if all units are 1.

        Variables have their :attr:`~ocp.problem.problem.Problem.natural` units. If these are SI units, the unit of a
        row is the power of two nearest to its change (:func:`~ocp.programs.units.row_units`), otherwise it is
        measured (:func:`~ocp.programs.units.measure_scale`). In shooting, whose rows may be steep, the unit of a row
        is at most 1, and outside SI only the cost is scaled.
        """
        import scipy.sparse as sp

        cost = self.problem.scales.cost
        table = self.problem.parameters + self.step.p

        def parameters(values: dict[str, float]) -> np.ndarray:
            return self.parameter_vector({PENALTY: 0.0, RELAXATION: 0.0, **values})

        def entries(z: np.ndarray, p: np.ndarray) -> tuple[float, sp.csr_matrix]:
            return float(self.f_g(z, p)[0]), sp.csr_matrix(self.jacobian(z, p)[1].sparse())

        x, units = self._variable_units(), self.problem.scaling.units
        shooting = "gap" not in self.variables
        if shooting and not units.is_si:
            return None if cost == 1 else Scale.none(self.n, self.m, cost)
        if units.is_si:
            largest = 1.0 if shooting else np.inf
            return row_scaled(x, entries, parameters(table.defaults), cost, largest)
        defining = np.full(self.m, -1)
        if self.step.n:
            defining[self.constraints["gap_definition"].index] = self.variables["gap"].index
        natural = {p.name: table.defaults[p.name] / units.of(p.unit) for p in table}
        measured_scale = measure_scale(x, defining, entries, parameters(table.defaults), parameters(natural))
        return replace(measured_scale, f=measured_scale.f * cost)

    def _variable_units(self) -> np.ndarray:
        """Return units of the variables (n,); outside SI units gaps have the unit 1 until rows are measured."""
        problem = self.problem
        natural, units = problem.natural, problem.scaling.units
        if units.is_si:
            ratio = np.tile(problem.pair_units, self.step.branches)
            lam = np.where(self._slips, natural.gap, natural.impulse) / ratio
            gap = np.where(self._slips, natural.impulse, natural.gap) * ratio
        else:
            lam = np.array([units.of(signal.unit) for signal in self.step.contacts])
            gap = np.ones_like(lam)
        return self._pack_sizes(natural, lam, gap)

    def active_sets(self, x: np.ndarray) -> list[np.ndarray]:
        """Return one or two masks (m,) of pairs whose gap is probably zero, since lam exceeds it in scaled units.

        If slip pairs make a difference, a first mask compares the members of all pairs as impulses and gaps, since
        neither mask alone is right for contacts that hardly slide.
        """
        by_sizes, sizes = super().active_sets(x), self.problem.natural_scales
        first, second = (x / self.natural.x)[self.pairs]
        by_impulses = first / sizes.impulse > second / sizes.gap
        return by_sizes if np.array_equal(by_sizes[0], by_impulses) else [by_impulses, *by_sizes]

    @property
    def chains(self) -> np.ndarray:
        """Indices of the pairs of each scenario and contact over all steps, (scenarios * contacts, N)."""
        if not self.pairs.size:
            return super().chains
        scenarios, steps, contacts = self.variables["lam"].shape
        order = np.arange(self.pairs.shape[1]).reshape(scenarios, steps, contacts)
        return order.transpose(0, 2, 1).reshape(-1, steps)

    def pair_name(self, index: int) -> PairName:
        """Return kind, contact (``<contact>#<branch>`` for an averaged law), scenario and step of a pair."""
        _, (scenario, step, i) = self.variables.locate(int(self.pairs[0, index]))
        kinds = self.problem.system.pairs
        return PairName(kinds[i % len(kinds)].kind, self.step.contacts[i].name, scenario, step)

    def _constraint_bounds(self, physical: np.ndarray, known_bounds: dict[str, tuple]) -> tuple[np.ndarray, np.ndarray]:
        lower, upper = {}, {}
        for kind, rows in (("path", self.problem.path), ("terminal", self.problem.terminal)):
            if kind in self.constraints and self.constraints[kind].size:
                ends = [ca.vertcat(*(getattr(row, end) for row in rows)) for end in ("lower", "upper")]
                evaluated = ca.Function("ends", [self.problem.parameters.vector], ends)(physical)
                lower[kind], upper[kind] = (np.array(end).ravel() for end in evaluated)
        for name in ("x", "u"):
            if f"{name}_bound" in self.constraints:
                lower[f"{name}_bound"], upper[f"{name}_bound"] = known_bounds[name]
        if "separation" in self.constraints:
            upper["separation"] = np.inf
        return self.constraints.pack(lower), self.constraints.pack(upper)


class StageCompiler:
    """Compiler of CasADi functions to C.

    Objects are cached in the user's cache directory by source, compiler and flags, so that a second solve compiles
    nothing. Without a compiler, or if it fails, functions are returned unchanged, and ``outcome`` states the reason.
    """

    def __init__(self) -> None:
        self._reason = ""

    def __call__(self, function: ca.Function) -> ca.Function:
        """Return the compiled function, or ``function`` if compilation has failed."""
        from dynamics.batch.engines.c_external import external_source
        from dynamics.batch.engines.compiler import load_library

        if self._reason:
            return function
        try:
            return ca.external(function.name(), load_library(external_source(function))._name)
        except RuntimeError as error:
            self._reason = str(error).strip().splitlines()[-1]
            return function

    @property
    def outcome(self) -> str:
        """``compiled``, or the reason why functions are interpreted."""
        return f"{self._reason}; functions are interpreted" if self._reason else "compiled"


@dataclass(frozen=True)
class Trajectories:
    """Planned trajectories of all scenarios: x (S, N+1, nx), u (S, N, nu); lam, gap, mu (S, N, n) of all branches."""

    x: np.ndarray
    u: np.ndarray
    lam: np.ndarray
    gap: np.ndarray
    mu: np.ndarray
    residual: np.ndarray
    gains: Gains | None


def trajectories(nlp: NLP, result: Result, p: np.ndarray) -> Trajectories:
    """Return the trajectories in an NLP's variables, with recomputed gap, mu and residual."""
    blocks = nlp.variables.unpack(result.point.x)
    problem, step = nlp.problem, nlp.step
    values = step.p.pack(dict(zip(nlp.names, p, strict=False)))
    S, N, nx = problem.scenarios.n, problem.N, problem.system.nx
    gains = Gains(blocks["K"], blocks["k"]) if "K" in blocks else None
    if nlp.trajectories is not None:
        outputs = nlp.trajectories(result.point.x, p)
        x, u, lam, _ = (np.array(v).T for v in outputs)
        x, u, lam = x.reshape(S, N + 1, nx), u.reshape(S, N, -1), lam.reshape(S, N, -1)
    else:
        x0 = nlp.data.unpack(p[len(nlp.names) :])["x0"][:, None]
        x = np.concatenate([blocks.get("x0", x0), blocks["x"]], axis=1)
        u = np.broadcast_to(blocks["u"], (S, N, problem.system.nu))
        lam = blocks.get("lam")
        if lam is None:
            lam = at_steps(step.solve, x[:, :-1], u, p=values)[1]
    residual, gap, mu = at_steps(step.relation, x[:, :-1], u, x[:, 1:], lam, p=values)
    return Trajectories(x, np.array(u), lam, gap, mu, residual, gains)
