"""Roll a plan out under a law, step by step, with its cost; initial guesses of a plan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass
from typing import Any

import casadi as ca
import numpy as np

from dynamics.contact import ContactLaw, Step
from ocp.errors import InputError, NotConverged
from ocp.problem.problem import Problem

STEP_TOLERANCE = 1e-7
_SPREAD = 0.3
InitialGuess = tuple[np.ndarray, np.ndarray]
"""States (N+1, nx) and inputs (N, nu)."""


@dataclass(frozen=True)
class Gains:
    """Feedback ``u = K x + k``: K (N or 1, nu, nx), k (N or 1, nu)."""

    K: np.ndarray
    k: np.ndarray

    def input(self, step: int, x: np.ndarray) -> np.ndarray:
        """Input at a step and state."""
        at = min(step, len(self.K) - 1)
        return self.K[at] @ x + self.k[at]


@dataclass(frozen=True)
class Rollout:
    """Trajectories of all scenarios: x (S, N+1, nx), u (S, N, nu), lam and gap (S, N, n).

    ``impulses`` (S, N, nlam) are those that the problem's cost depends on
    (:func:`problem_impulses`), ``costs`` (S,) the scenarios' costs, ``cost`` their mean.
    """

    x: np.ndarray
    u: np.ndarray
    lam: np.ndarray
    gap: np.ndarray
    impulses: np.ndarray
    costs: np.ndarray

    @property
    def cost(self) -> float:
        """Mean cost over scenarios."""
        return float(self.costs.mean())

    def __getitem__(self, which: Sequence[int] | np.ndarray) -> Rollout:
        """The scenarios ``which`` alone."""
        return Rollout(*(part[which] for part in astuple(self)))


@dataclass(frozen=True)
class Unsolved:
    """A step that did not converge: where, and how far its worst pair is off.

    ``contact`` names that pair; ``violation`` is the step solver's scaled error, infinite where
    it is NaN.
    """

    step: int
    contact: str
    scenario: int
    violation: float

    @property
    def brief(self) -> str:
        """Step and contact alone."""
        return f"step {self.step} did not converge, contact {self.contact!r}"

    def __str__(self) -> str:
        return (
            f"contact {self.contact!r} did not converge at step {self.step} of scenario"
            f" {self.scenario}: violation {self.violation:.1e}; the state there may be far out of"
            " range"
        )


def at_steps(function: ca.Function, *arrays: np.ndarray, p: np.ndarray) -> list[np.ndarray]:
    """Evaluate ``function(*columns, p)`` at every scenario and step of arrays (S, N, .)."""
    S, N = arrays[0].shape[:2]
    columns = [ca.DM(part.reshape(S * N, part.shape[2]).T) for part in arrays]
    found = function.map(S * N).call([*columns, ca.DM(p)])
    return [np.array(value).T.reshape(S, N, value.shape[0]) for value in found]


def roll_out(
    problem: Problem,
    inputs: np.ndarray | Gains,
    values: dict[str, float],
    law: ContactLaw | Step | None = None,
    x0: np.ndarray | None = None,
) -> Rollout:
    """Roll out ``inputs`` (S or 1, N, nu), or gains, under ``law``, by default the exact one.

    ``values`` are parameter values by name; a law brings its own, a closed step takes them
    from ``values``. ``x0`` (S, nx) are initial states, by default the problem's scenarios; inputs
    from gains are clipped to the bounds on u, as an actuator would.

    Raises :class:`~ocp.errors.NotConverged`, naming contact, step and scenario, where the step's
    path could not be followed to its end.
    """
    rolled, unsolved = roll_on(problem, inputs, values, law, x0)
    if unsolved is not None:
        raise NotConverged(str(unsolved))
    return rolled


def roll_on(
    problem: Problem,
    inputs: np.ndarray | Gains,
    values: dict[str, float],
    law: ContactLaw | Step | None = None,
    x0: np.ndarray | None = None,
    substeps: int = 1,
    first: int = 0,
) -> tuple[Rollout, Unsolved | None]:
    """Roll out as :func:`roll_out` does, and say where it ended instead of raising.

    A closed step may be that of another system with the same states, inputs and parameters as the
    problem's, such as its ``sharpest``. A scenario whose step was not solved is NaN from the next
    node on, and so is its cost; the first such step is returned, None where there is none.

    With ``substeps`` every input, or the policy's answer at a node, is held over so many steps, and
    what is returned are the problem's nodes, the sum of lam and the last gap between two of them;
    the step size must then have been divided already, in ``values`` or in ``x0``. With ``first``,
    ``x0`` are the states at that node; all before it, and so the costs, are NaN.
    """
    if law is None:
        step = problem.exact_step
    else:
        step = law if isinstance(law, Step) else law.close(problem.system)
    p = step_values(problem, step, values, own=step is law)
    physical = problem.parameters.pack(values)
    nx, nu = problem.system.nx, problem.system.nu
    start = problem.initial_states(physical) if x0 is None else _array("x0", x0, (None, nx))
    lower, upper = (np.array(v).ravel() for v in problem.limits(physical)[2:4])
    S, N = len(start), problem.N
    x, u = np.full((S, N + 1, nx), np.nan), np.empty((S, N, nu))
    lam, gap = np.full((S, N, step.n), np.nan), np.full((S, N, step.n), np.nan)
    u[:] = np.nan if isinstance(inputs, Gains) else _array("inputs", inputs, (None, N, nu), S)
    error = np.zeros((S, N, step.n))
    x[:, first] = start
    # Gains read the state of every node; inputs are rolled out in one call.
    each = 1 if isinstance(inputs, Gains) else N
    for k in range(first, N, each):
        steps = slice(k, k + each)
        if isinstance(inputs, Gains):
            u[:, k] = [np.clip(inputs.input(k, one), lower, upper) for one in x[:, k]]
        x[:, 1:][:, steps], lam[:, steps], gap[:, steps], error[:, steps] = _ahead(
            step, x[:, k], u[:, steps], p, substeps
        )
    lost: list[Unsolved] = []
    wrong = ~np.all(error <= STEP_TOLERANCE, axis=2)
    for s in np.flatnonzero(wrong.any(axis=1)):
        k = int(np.argmax(wrong[s]))
        x[s, k + 1 :], lam[s, k:], gap[s, k:] = np.nan, np.nan, np.nan
        worst = int(np.argmax(error[s, k]))
        lost.append(Unsolved(k, step.contacts[worst].name, int(s), float(error[s, k, worst])))
    impulses = problem_impulses(problem, step, x, u, lam, physical)
    costs = trajectory_costs(problem, x, u, impulses, physical)
    rolled = Rollout(x, u, lam, gap, impulses, costs)
    for one in lost:
        rolled.costs[one.scenario] = np.nan
    return rolled, min(lost, key=lambda one: one.step, default=None)


def _array(what: str, given: Any, shape: tuple[int | None, ...], scenarios: int | None = None) -> np.ndarray:
    """``given`` as an array of ``shape``, its first size 1 or ``scenarios``; any where None.

    Raises :class:`~ocp.errors.InputError` for another shape, and for what are no numbers.
    """
    first = "S" if scenarios is None else str(scenarios)
    expected = f"({', '.join([first, *map(str, shape[1:])])})"
    try:
        found = np.asarray(given, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{what} must be an array {expected} of numbers, got {given!r}") from None
    found = found.reshape((1,) * (len(shape) - found.ndim) + found.shape)
    fits = scenarios is None or found.shape[0] in (1, scenarios)
    if not fits or found.shape[1:] != shape[1:]:
        raise InputError(f"{what} must be an array {expected}, got the shape {np.shape(given)}")
    return found


def step_values(problem: Problem, step: Step, values: dict[str, float], own: bool = True) -> np.ndarray:
    """Values of a step's parameters: by name, and the law's own where ``values`` has none.

    Without ``own`` the law's parameters are its settings, whatever ``values`` holds.
    """
    chosen = values if own else {k: v for k, v in values.items() if k in problem.parameters}
    return step.p.pack(chosen)


def _ahead(
    step: Step, x: np.ndarray, u: np.ndarray, p: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Roll states x (S, nx) on by inputs u (S, K, nu), each held for ``count`` steps.

    Returns, by input, the state after its steps (S, K, nx), the sum of lam and the last gap
    (S, K, n), and the largest error of any (S, K, n). That is infinite where a state is NaN: a
    single contact, solved in closed form, has no error of its own.
    """
    S, K = u.shape[:2]
    rolled = step.solve.map(S).mapaccum(K * count)
    columns = np.repeat(u, count, axis=1).swapaxes(0, 1).reshape(K * count * S, u.shape[2]).T
    found = (np.array(v).T.reshape(K, count, S, v.shape[0]).transpose(2, 0, 1, 3) for v in rolled(x.T, columns, p))
    after, lam, gap, error = found
    right = np.isfinite(error) & np.isfinite(after).all(axis=3, keepdims=True)
    largest = np.where(right, error, np.inf).max(axis=2, initial=0.0)
    return after[:, :, -1], lam.sum(axis=2), gap[:, :, -1], largest


def mean_multipliers(step: Step, lam: np.ndarray) -> np.ndarray:
    """Multipliers (S, N, nlam), averaged over a law's branches by their weights.

    NaN where the law has none, though the system has contacts: a learned law knows no forces.
    """
    if step.n < step.system.nlam:
        return np.full((*lam.shape[:2], step.system.nlam), np.nan)
    weights = np.array([node.weight for node in step.nodes])
    branches = lam.reshape(*lam.shape[:2], len(weights), step.system.nlam)
    return np.einsum("snbl,b->snl", branches, weights)


def problem_impulses(
    problem: Problem,
    step: Step,
    x: np.ndarray,
    u: np.ndarray,
    lam: np.ndarray,
    physical: np.ndarray,
) -> np.ndarray:
    """Impulses of the contacts of the problem's system, (S, N, nlam), from a step's (S, N, n).

    They are the mean over the step's branches. A step of another system, which has friction in
    place of the edges of a cone, is matched by the normal and tangential impulses of every contact.
    NaN where neither the cost nor a path constraint depends on impulses, or none can be matched.
    """
    own, other = problem.system, step.system
    unknown = np.full((*lam.shape[:2], own.nlam), np.nan)
    if not problem.uses_impulses or step.n == 0:
        return unknown
    mean = mean_multipliers(step, lam)
    if [one.name for one in own.contacts] == [one.name for one in other.contacts]:
        return mean
    if own.forces is None or other.forces is None:
        return unknown
    sought, given = (ca.vertcat(one.normal, one.tangential) for one in (own.forces, other.forces))
    sought = ca.jacobian(sought, own.lam)
    given = ca.substitute(given, ca.vertcat(other.x, other.u), ca.vertcat(own.x, own.u))
    matched = ca.Function(
        "matched",
        [own.x, own.u, other.lam, problem.parameters.vector],
        [ca.vec(ca.densify(sought)), ca.densify(given)],
    )
    columns, forces = at_steps(matched, x[:, :-1], u, mean, p=physical)
    edges = columns.reshape(*lam.shape[:2], own.nlam, -1).swapaxes(2, 3)
    found = np.linalg.pinv(np.nan_to_num(edges)) @ forces[..., None]
    return found[..., 0]


def trajectory_costs(
    problem: Problem, x: np.ndarray, u: np.ndarray, impulses: np.ndarray, physical: np.ndarray
) -> np.ndarray:
    """Cost of trajectories x (S, N+1, nx), u (S, N, nu), impulses (S, N, nlam); returns (S,)."""
    before = np.array(problem.limits(physical)[1]).ravel()
    du = np.diff(u, axis=1, prepend=np.broadcast_to(before, (len(u), 1, before.size)))
    stage, _ = at_steps(problem.cost_terms, x[:, :-1], u, du, impulses, p=physical)
    last = (part[:, -1:] for part in (x, u, du, impulses))
    _, terminal = at_steps(problem.cost_terms, *last, p=physical)
    return stage.sum(axis=(1, 2)) + terminal[:, 0, 0]


def initial_guesses(
    problem: Problem,
    values: dict[str, float],
    count: int,
    seed: int,
    first: InitialGuess | None = None,
) -> list[InitialGuess]:
    """Return the problem's own guess, or ``first``, and perturbed ones, ``count`` in all.

    The noise has 0.3 characteristic units, each guess its own stream of the seed.
    """
    X, U = first if first is not None else problem.initial_guess(problem.parameters.pack(values))
    found, sizes = [(X, U)], problem.scales
    for stream in np.random.SeedSequence(seed).spawn(count - 1):
        noise = np.random.default_rng(stream)
        moved = X + _SPREAD * sizes.x * noise.standard_normal(X.shape)
        moved[0] = X[0]
        found.append((moved, U + _SPREAD * sizes.u * noise.standard_normal(U.shape)))
    return found
