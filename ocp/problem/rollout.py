"""Rollouts of a plan under a law, step by step, with costs; and initial guesses of a plan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass
from typing import Any, Protocol, runtime_checkable

import casadi as ca
import numpy as np

from dynamics.contact import ContactLaw, Step
from ocp.errors import InputError, NotConverged
from ocp.problem.evaluation import Evaluation, at_steps
from ocp.problem.problem import Problem

STEP_TOLERANCE = 1e-7
"""Largest scaled error of the step solver for which a step counts as solved."""
MAX_PAIRS = 60
"""Maximum number of pairs for steps to be repeated in one graph; with 144, building that graph takes 10 s."""
_GUESS_NOISE = 0.3
"""Standard deviation of the noise on guesses, in characteristic sizes."""
InitialGuess = tuple[np.ndarray, np.ndarray]
"""States (N+1, nx) and inputs (N, nu) of a guess."""


@runtime_checkable
class StateFeedback(Protocol):
    """Interface of a function of the state that gives the inputs of a rollout at each node."""

    def input(self, step: int, x: np.ndarray) -> np.ndarray:
        """Return the input (nu,) at a step and state (nx,)."""
        ...


@dataclass(frozen=True)
class Gains:
    """Feedback ``u = K x + k`` with K (N or 1, nu, nx) and k (N or 1, nu)."""

    K: np.ndarray
    k: np.ndarray

    def input(self, step: int, x: np.ndarray) -> np.ndarray:
        """Return the input (nu,) at a step and a state x (nx,)."""
        row = min(step, len(self.K) - 1)
        return self.K[row] @ x + self.k[row]


def policy_name(inputs: np.ndarray | StateFeedback) -> str:
    """Return the kind of policy: "open-loop" for an array of inputs, "feedback" for gains, or else "controller"."""
    if isinstance(inputs, np.ndarray):
        return "open-loop"
    return "feedback" if isinstance(inputs, Gains) else "controller"


@dataclass(frozen=True)
class Rollout:
    """Trajectories of all scenarios: x (S, N+1, nx), u (S, N, nu), lam and gap (S, N, n).

    ``impulses`` (S, N, nlam) are the impulses that the problem's cost depends on
    (:func:`problem_impulses`); ``costs`` (S,) are the costs of the scenarios, and ``cost`` is their mean.
    """

    x: np.ndarray
    u: np.ndarray
    lam: np.ndarray
    gap: np.ndarray
    impulses: np.ndarray
    costs: np.ndarray

    @classmethod
    def from_trajectories(
        cls, evaluation: Evaluation, step: Step, x: np.ndarray, u: np.ndarray, lam: np.ndarray, gap: np.ndarray
    ) -> Rollout:
        """Return trajectories of ``step`` as a rollout, with the problem's impulses and costs."""
        impulses = problem_impulses(evaluation, step, x, u, lam)
        return cls(x, u, lam, gap, impulses, evaluation.trajectory_costs(x, u, impulses))

    @property
    def cost(self) -> float:
        """Mean cost over scenarios."""
        return float(self.costs.mean())

    def __getitem__(self, scenarios: Sequence[int] | np.ndarray) -> Rollout:
        """Return the rollout of the scenarios with the indices ``scenarios``."""
        return Rollout(*(array[scenarios] for array in astuple(self)))


@dataclass(frozen=True)
class Unsolved:
    """A step of a rollout that did not converge, with its scenario and contact.

    ``contact`` is the name of the pair with the largest error; ``violation`` is this error, scaled by the
    step solver, and infinite instead of NaN.
    """

    step: int
    contact: str
    scenario: int
    violation: float

    @property
    def brief(self) -> str:
        """Clause that names only the step and the contact."""
        return f"step {self.step} did not converge, contact {self.contact!r}"

    def __str__(self) -> str:
        return (
            f"contact {self.contact!r} did not converge at step {self.step} of scenario"
            f" {self.scenario}: violation {self.violation:.1e}; the state there may be far out of"
            " range"
        )


def roll_out(
    problem: Problem,
    inputs: np.ndarray | StateFeedback,
    values: dict[str, float],
    contact: ContactLaw | Step | None = None,
    x0: np.ndarray | None = None,
) -> Rollout:
    """Return the rollout of ``inputs`` (S or 1, N, nu), or gains, under the law ``contact`` (default: exact).

    ``values`` is a dict from parameters to values. If ``contact`` is a law, its settings apply; if it is a
    step, the law's parameters in ``values`` apply. ``x0`` (S, nx) are initial states, by default the problem's
    scenarios. Inputs from gains are clipped to the bounds on u, as an actuator would clip them.

    Raises :class:`~ocp.errors.NotConverged`, with contact, step and scenario, if a step was not solved.
    """
    rolled, unsolved = roll_on(Evaluation(problem, values), inputs, contact, x0)
    if unsolved is not None:
        raise NotConverged(str(unsolved))
    return rolled


def roll_on(
    evaluation: Evaluation,
    inputs: np.ndarray | StateFeedback,
    law: ContactLaw | Step | None = None,
    x0: np.ndarray | None = None,
    substeps: int = 1,
    first: int = 0,
) -> tuple[Rollout, Unsolved | None]:
    """Return the rollout as :func:`roll_out` does, and the first step that was not solved, without raising an error.

    A step may belong to another system with the same states, inputs and parameters as the problem's system, such as
    its ``most_exact``. If a step of a scenario was not solved, the scenario is NaN from the next node on, and its
    cost is NaN. The second result is None if every step was solved.

    With ``substeps`` every input, or the policy's input at a node, is held over that many steps; the rollout has the
    states at the problem's nodes, and between two nodes the sum of lam and the last gap. The step size must then
    already be divided, in the values or in ``x0``. With ``first``, ``x0`` are the states at this node; all earlier
    values, and therefore the costs, are NaN.
    """
    problem, limits = evaluation.problem, evaluation.limits
    if law is None:
        step = problem.exact_step
    else:
        step = law if isinstance(law, Step) else law.close(problem.system)
    p = evaluation.step_values(step, with_law_values=step is law)
    nx, nu = problem.system.nx, problem.system.nu
    start = evaluation.initial_states if x0 is None else _array("x0", x0, (None, nx))
    S, N = len(start), problem.N
    x, u = np.full((S, N + 1, nx), np.nan), np.empty((S, N, nu))
    lam, gap = np.full((S, N, step.n), np.nan), np.full((S, N, step.n), np.nan)
    u[:] = np.nan if isinstance(inputs, StateFeedback) else _array("inputs", inputs, (None, N, nu), S)
    error = np.zeros((S, N, step.n))
    x[:, first] = start
    # A policy needs the state at every node; open-loop inputs are rolled out in one call.
    stride = 1 if isinstance(inputs, StateFeedback) else N
    for k in range(first, N, stride):
        steps = slice(k, k + stride)
        if isinstance(inputs, StateFeedback):
            u[:, k] = [np.clip(inputs.input(k, state), limits.u_lower, limits.u_upper) for state in x[:, k]]
        x[:, 1:][:, steps], lam[:, steps], gap[:, steps], error[:, steps] = _roll_inputs(
            step, x[:, k], u[:, steps], p, substeps
        )
    unsolved: list[Unsolved] = []
    failed = ~np.all(error <= STEP_TOLERANCE, axis=2)
    for s in np.flatnonzero(failed.any(axis=1)):
        k = int(np.argmax(failed[s]))
        x[s, k + 1 :], lam[s, k:], gap[s, k:] = np.nan, np.nan, np.nan
        worst = int(np.argmax(error[s, k]))
        unsolved.append(Unsolved(k, step.contacts[worst].name, int(s), float(error[s, k, worst])))
    rolled = Rollout.from_trajectories(evaluation, step, x, u, lam, gap)
    for failure in unsolved:
        rolled.costs[failure.scenario] = np.nan
    return rolled, min(unsolved, key=lambda failure: failure.step, default=None)


def _array(label: str, value: Any, shape: tuple[int | None, ...], scenarios: int | None = None) -> np.ndarray:
    """Return ``value`` as an array of ``shape``; its first size may be 1 or ``scenarios``, or any size if that is None.

    Raises :class:`~ocp.errors.InputError` for any other shape, and for values that are not numbers.
    """
    first = "S" if scenarios is None else str(scenarios)
    expected = f"({', '.join([first, *map(str, shape[1:])])})"
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{label} must be an array {expected} of numbers, got {value!r}") from None
    array = array.reshape((1,) * (len(shape) - array.ndim) + array.shape)
    fits = scenarios is None or array.shape[0] in (1, scenarios)
    if not fits or array.shape[1:] != shape[1:]:
        raise InputError(f"{label} must be an array {expected}, got the shape {np.shape(value)}")
    return array


def _roll_inputs(
    step: Step, x: np.ndarray, u: np.ndarray, p: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return results of inputs u (S, K, nu), each held for ``count`` steps, from states x (S, nx).

    The results for each input are the state after its steps (S, K, nx), the sum of lam and the last gap
    (S, K, n), and the largest error of its steps (S, K, n). The error is set to infinity if a state
    is NaN, since the closed-form solution of a single contact does not report an error.
    """
    S, K = u.shape[:2]
    columns = np.repeat(u, count, axis=1).swapaxes(0, 1).reshape(K * count * S, u.shape[2]).T
    solve = step.solve.map(S)
    results = solve.mapaccum(K * count)(x.T, columns, p) if step.n <= MAX_PAIRS else _repeated(solve, x.T, columns, p)
    outputs = (np.array(v).T.reshape(K, count, S, v.shape[0]).transpose(2, 0, 1, 3) for v in results)
    x_after, lam, gap, error = outputs
    is_solved = np.isfinite(error) & np.isfinite(x_after).all(axis=3, keepdims=True)
    largest = np.where(is_solved, error, np.inf).max(axis=2, initial=0.0)
    return x_after[:, :, -1], lam.sum(axis=2), gap[:, :, -1], largest


def _repeated(solve: ca.Function, x: np.ndarray, u: np.ndarray, p: np.ndarray) -> list[np.ndarray]:
    """Return what ``solve.mapaccum`` does, from states x (nx, S) and inputs u (nu, steps * S)."""
    results: list[list[np.ndarray]] = []
    for columns in np.hsplit(u, u.shape[1] // x.shape[1]):
        results.append([np.array(part) for part in solve(results[-1][0] if results else x, columns, p)])
    return [np.hstack(part) for part in zip(*results, strict=True)]


def mean_multipliers(step: Step, lam: np.ndarray) -> np.ndarray:
    """Return the multipliers (S, N, nlam), averaged over a law's branches with their weights.

    The result is NaN if the law has no multipliers although the system has contacts, as for a learned law.
    """
    if step.n < step.system.nlam:
        return np.full((*lam.shape[:2], step.system.nlam), np.nan)
    weights = np.array([node.weight for node in step.nodes])
    branches = lam.reshape(*lam.shape[:2], len(weights), step.system.nlam)
    return np.einsum("snbl,b->snl", branches, weights)


def problem_impulses(evaluation: Evaluation, step: Step, x: np.ndarray, u: np.ndarray, lam: np.ndarray) -> np.ndarray:
    """Return the impulses (S, N, nlam) of the problem's contacts, given multipliers (S, N, n) of a step.

    They are averaged over the step's branches. A step of another system, such as one with Coulomb
    friction instead of a pyramid, is matched by the normal and tangential impulses of every contact.
    The result is NaN if neither the cost nor a path constraint depends on impulses, or if they cannot be matched.
    """
    problem = evaluation.problem
    system, step_system = problem.system, step.system
    unknown = np.full((*lam.shape[:2], system.nlam), np.nan)
    if not problem.uses_impulses or step.n == 0:
        return unknown
    mean = mean_multipliers(step, lam)
    if [contact.name for contact in system.contacts] == [contact.name for contact in step_system.contacts]:
        return mean
    if system.forces is None or step_system.forces is None:
        return unknown
    system_forces, other_forces = (
        ca.vertcat(forces.normal, forces.tangential) for forces in (system.forces, step_system.forces)
    )
    matched = ca.Function(
        "matched",
        [system.x, system.u, step_system.lam, problem.parameters.vector],
        [
            ca.vec(ca.densify(ca.jacobian(system_forces, system.lam))),
            ca.densify(
                ca.substitute(other_forces, ca.vertcat(step_system.x, step_system.u), ca.vertcat(system.x, system.u))
            ),
        ],
    )
    columns, forces = at_steps(matched, x[:, :-1], u, mean, p=evaluation.p)
    edges = columns.reshape(*lam.shape[:2], system.nlam, -1).swapaxes(2, 3)
    return (np.linalg.pinv(np.nan_to_num(edges)) @ forces[..., None])[..., 0]


def initial_guesses(
    evaluation: Evaluation, count: int, seed: int, first: InitialGuess | None = None
) -> list[InitialGuess]:
    """Return ``count`` guesses: ``first`` (default: the problem's guess) and perturbations of it.

    The noise has a standard deviation of 0.3 characteristic sizes; each guess has its own random stream.
    """
    X, U = first if first is not None else evaluation.initial_guess
    guesses, sizes = [(X, U)], evaluation.problem.scales
    for stream in np.random.SeedSequence(seed).spawn(count - 1):
        noise = np.random.default_rng(stream)
        states = X + _GUESS_NOISE * sizes.x * noise.standard_normal(X.shape)
        states[0] = X[0]
        guesses.append((states, U + _GUESS_NOISE * sizes.u * noise.standard_normal(U.shape)))
    return guesses
