"""Tree search over pushes: the pusher's position, the side that it presses, and the duration.

From each state the pusher moves around obstacles to a point on a body, and pushes it. Every such
motion is rolled out under the exact law.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from scipy.sparse.csgraph import dijkstra

from dynamics.batch import BatchFunction
from ocp.problem.evaluation import Evaluation, at_steps
from ocp.problem.problem import DEPTH, SHARES, SWEPT, Problem
from ocp.problem.rollout import Rollout
from ocp.search.near_steps import NearSteps

_ROUNDS, _BEAM = 4, 8
"""Maximum number of successive pushes, and of plans that each round extends."""
_TOUCHES, _PUSHES = 12, 4
"""Maximum number of touched points for each contact from one state, and of pushes at each point."""
_ALL_TOUCHES = 48
"""Maximum number of touched points for all contacts from one state, which limits the work in a scene of many bodies."""
_STOPS, _ALONG = 40, 12
"""Number of random waypoints of paths, and of collision checks along the line between two waypoints."""
_REACH = 3.0
"""Longest push, and half the width of the region where touched points are drawn, in characteristic sizes."""
_NEWTON = 6
"""Number of Newton steps that move a pusher onto a body."""
_CLEAR, _TOUCHED = 0.02, 1e-3
"""Distance between a path and bodies, and distance at which a pusher touches, in characteristic gaps."""


@dataclass(frozen=True)
class Node:
    """First k steps of a plan: states (k+1, nx), inputs (k, nu), cost, and the cost if nothing moves afterwards."""

    x: np.ndarray
    u: np.ndarray
    cost: float
    resting: float


def searchable(problem: Problem) -> bool:
    """Return whether inputs are commanded positions of pushers on springs and signed distances are known."""
    system = problem.system
    if system.stiffness is None or system.mass is None or problem.signed_distance is None:
        return False
    if not system.nlam:
        return False
    single = problem.scenarios.n == 1 and problem.start is None
    return single and system.mass.shape[0] + system.stiffness.shape[0] == system.nx


class TouchSearch:
    """Tree search over random pushes for a ``problem`` at parameter ``values``.

    ``tried`` counts the simulated motions, ``rolled`` their steps.
    """

    def __init__(self, problem: Problem, values: dict[str, float], seed: int = 0) -> None:
        self.problem = problem
        self.evaluation = Evaluation(problem, values)
        self.limits = self.evaluation.limits
        self.rng = np.random.default_rng(seed)
        self.tried = self.rolled = 0
        self._step = NearSteps(self.evaluation, problem.referee_step.system)
        is_same_system = problem.referee_step.system is problem.system
        self._model_step = self._step if is_same_system else NearSteps(self.evaluation, problem.system)

    @cached_property
    def _distance(self) -> Callable[[np.ndarray], np.ndarray]:
        phi = self.problem.signed_distance
        assert phi is not None
        batch = BatchFunction(phi, backend="numpy")
        return lambda x: np.asarray(batch(x, self.evaluation.p))

    @cached_property
    def _slope(self) -> Callable[[np.ndarray], np.ndarray]:
        """Function from states (n, nx) to the gradients (n, nc, nu) of distances in the pushers' coordinates."""
        system = self.problem.system
        assert system.phi is not None
        J = ca.densify(ca.jacobian(system.phi, system.x)[:, -system.nu :])
        distance_slope = ca.Function("slope", [system.x, self.problem.parameters.vector], [ca.vec(J.T)])
        batch = BatchFunction(distance_slope, backend="numpy")
        return lambda x: np.asarray(batch(x, self.evaluation.p)).reshape(len(x), -1, system.nu)

    @cached_property
    def _pressed(self) -> list[tuple[int, np.ndarray]]:
        """Indices of contacts between a pusher and a body, each with the indices of the pusher's coordinates."""
        system = self.problem.system
        assert system.phi is not None
        by = np.array(ca.DM(ca.jacobian(system.phi, system.x).sparsity(), 1).full(), dtype=bool)
        coordinates = by[:, -system.nu :]
        touches = np.flatnonzero(by[:, : -system.nu].any(axis=1) & coordinates.any(axis=1))
        return [(int(i), np.flatnonzero(coordinates[i])) for i in touches]

    def first(self) -> Node:
        """Return the node of the start, without steps."""
        x0 = self.limits.x0[None]
        return Node(x0, np.zeros((0, self._nu)), 0.0, self._cost_at_rest(x0, np.zeros(1))[0])

    def rounds(self, rounds: int = _ROUNDS) -> Iterator[list[Node]]:
        """Yield after every round the best plans so far, in order of their cost if nothing moves afterwards."""
        beam = [self.first()]
        pushed_nodes = list(beam)
        for _ in range(rounds):
            grown = self.pushed(beam)
            pushed_nodes += grown
            open_ended = [n for n in (*grown, *beam) if len(n.u) < self.problem.N - 1]
            beam = self._distinct_nodes(sorted(open_ended, key=lambda n: n.resting), _BEAM)
            yield self._distinct_nodes(sorted(pushed_nodes, key=lambda n: n.resting), _BEAM)
            if not beam:
                break

    def _distinct_nodes(self, nodes: list[Node], most: int) -> list[Node]:
        """Return the first ``most`` nodes in which bodies end at different positions."""
        free, sizes = slice(0, -self.problem.system.nu), self.problem.scales.x
        distinct: list[Node] = []
        for node in nodes:
            ends = [np.abs((node.x[-1] - selected.x[-1]) / sizes)[free].max() for selected in distinct]
            if len(distinct) < most and min(ends, default=np.inf) > 0.05:
                distinct.append(node)
        return distinct

    def pushed(self, beam: list[Node]) -> list[Node]:
        """Return the nodes after pushes from every node of ``beam``, without nodes that pass through a body."""
        plans: dict[int, list[tuple[Node, np.ndarray]]] = {}
        for node in beam:
            u_before = node.u[-1] if len(node.u) else self.limits.u_before
            steps_left = self.problem.N - len(node.u)
            for polyline in self._push_paths(node.x[-1], u_before):
                for steps in {steps_left, min(steps_left, max(2, steps_left // 2))}:
                    plans.setdefault(steps, []).append((node, self._timed(polyline, steps)))
        return [node for steps in sorted(plans) for node in self._rolled(plans[steps])]

    @property
    def _nu(self) -> int:
        return self.problem.system.nu

    def _push_paths(self, x: np.ndarray, before: np.ndarray) -> list[np.ndarray]:
        """Return polylines (n, nu) of commanded positions that lead to a point on a body and then push it."""
        polylines, most = [], min(_TOUCHES, max(_ALL_TOUCHES // max(len(self._pressed), 1), 1))
        for contact, coordinates in self._pressed:
            points = self._contact_positions(x, contact, coordinates)[:most]
            if not len(points):
                continue
            paths = self._paths(x, coordinates, points)
            for point, path in zip(points, paths, strict=True):
                if path is None:
                    continue
                touch_points = x.copy()
                touch_points[-self._nu :] = point
                into = -self._slope(touch_points[None])[0, contact]
                ends = [self._push_end(point, into, coordinates) for _ in range(_PUSHES)]
                polylines += [np.vstack([before, *path, end]) for end in ends]
        return polylines

    def _push_end(self, point: np.ndarray, into: np.ndarray, coordinates: np.ndarray) -> np.ndarray:
        """Return the commanded end (nu,) of a push of random length from ``point``, about in the direction ``into``."""
        size = float(self.problem.scales.x[-1])
        length = size * np.exp(self.rng.uniform(np.log(0.1), np.log(_REACH)))
        polyline = into.copy()
        if len(coordinates) == 2:
            angle = self.rng.normal(0, 0.35)
            c, s = np.cos(angle), np.sin(angle)
            polyline[coordinates] = np.array([[c, -s], [s, c]]) @ into[coordinates]
        return np.clip(point + length * polyline, self.limits.u_lower, self.limits.u_upper)

    def _contact_positions(self, x: np.ndarray, contact: int, coordinates: np.ndarray) -> np.ndarray:
        """Return pusher positions (n, nu) at which ``contact`` closes, by Newton's method from random guesses."""
        sizes, nu = self.problem.scales, self._nu
        touch_states = np.repeat(x[None], 4 * _TOUCHES, axis=0)
        sampled_places = self.rng.uniform(-_REACH, _REACH, (len(touch_states), len(coordinates)))
        positions = x.size - nu + coordinates
        nearest = touch_states[:1].copy()
        self._newton(nearest, contact, positions)
        touch_states[:, positions] = nearest[0, positions] + sizes.x[positions] * sampled_places
        self._newton(touch_states, contact, positions)
        gap = self._distance(touch_states)
        inside = np.all(touch_states[:, -nu:] >= self.limits.u_lower, axis=1)
        inside &= np.all(touch_states[:, -nu:] <= self.limits.u_upper, axis=1)
        depends = np.abs(self._slope(touch_states)).sum(axis=2) > 0
        clear = np.where(depends, gap, np.inf).min(axis=1) > -_TOUCHED * sizes.gap
        is_touching = inside & clear & (np.abs(gap[:, contact]) < _TOUCHED * sizes.gap)
        return touch_states[is_touching][:_TOUCHES, -nu:]

    def _newton(self, states: np.ndarray, contact: int, positions: np.ndarray) -> None:
        for _ in range(_NEWTON):
            gap, slope = self._distance(states)[:, contact], self._slope(states)[:, contact]
            slope = slope[:, positions - (states.shape[1] - self._nu)]
            size = np.maximum((slope**2).sum(axis=1), 1e-9)
            states[:, positions] -= (gap / size)[:, None] * slope

    def _paths(self, x: np.ndarray, coordinates: np.ndarray, goals: np.ndarray) -> list[list[np.ndarray] | None]:
        """Return a pusher's shortest collision-free path via random waypoints to each goal, None if there is none."""
        nu, sizes = self._nu, self.problem.scales
        middle = np.vstack([x[-nu:], goals])
        low, high = middle.min(axis=0), middle.max(axis=0)
        stops = np.repeat(x[None, -nu:], _STOPS, axis=0)
        margin = 0.5 * sizes.x[-nu:]
        stops[:, coordinates] = self.rng.uniform(
            (low - margin)[coordinates], (high + margin)[coordinates], (_STOPS, len(coordinates))
        )
        # Points at a distance from every goal, since a pusher leaves and reaches a body along its normal.
        steps_back = self._moved_outwards(x, np.vstack([x[None, -nu:], goals]))
        all_places = np.vstack([x[None, -nu:], goals, steps_back, stops])
        states = np.repeat(x[None], len(all_places), axis=0)
        states[:, -nu:] = all_places
        depends = np.abs(self._slope(states)).sum(axis=(0, 2)) > 0
        first, second = np.triu_indices(len(all_places), 1)
        shares = np.linspace(0, 1, _ALONG)[:, None, None]
        way_points = all_places[first] * (1 - shares) + all_places[second] * shares
        way_states = np.broadcast_to(x, (*way_points.shape[:2], x.size)).copy()
        way_states[:, :, -nu:] = way_points
        gap = self._distance(way_states.reshape(-1, x.size)).reshape(*way_points.shape[:2], -1)
        smallest_gap = gap[:, :, depends].min(axis=2)
        ends = np.minimum(smallest_gap[0], smallest_gap[-1])
        free = (smallest_gap >= np.minimum(_CLEAR * sizes.gap, ends) - _TOUCHED * sizes.gap).all(axis=0)
        free &= ends > -2 * _TOUCHED * sizes.gap
        length = np.linalg.norm(all_places[first] - all_places[second], axis=1)
        graph = np.zeros((len(all_places), len(all_places)))
        graph[first[free], second[free]] = np.maximum(length[free], 1e-12)
        path_lengths, previous = dijkstra(graph, directed=False, indices=0, return_predecessors=True)
        paths: list[list[np.ndarray] | None] = []
        for goal in range(1, len(goals) + 1):
            if not np.isfinite(path_lengths[goal]):
                paths.append(None)
                continue
            stop, path = goal, []
            while stop > 0:
                path.insert(0, all_places[stop])
                stop = int(previous[stop])
            paths.append(path)
        return paths

    def _moved_outwards(self, x: np.ndarray, positions: np.ndarray) -> np.ndarray:
        """Return the ``positions`` (n, nu), each moved away from the nearest body."""
        states = np.repeat(x[None], len(positions), axis=0)
        states[:, -self._nu :] = positions
        slope = self._slope(states)
        gap = np.where(np.abs(slope).sum(axis=2) > 0, self._distance(states), np.inf)
        nearest = slope[np.arange(len(states)), gap.argmin(axis=1)]
        return positions + 1.5 * self.problem.scales.gap * nearest

    def _timed(self, polyline: np.ndarray, steps: int) -> np.ndarray:
        """Return commands (steps, nu), equally spaced along a polyline."""
        lengths = np.linalg.norm(np.diff(polyline, axis=0), axis=1)
        travelled = np.concatenate([[0.0], np.cumsum(lengths)])
        arc_lengths = travelled[-1] * np.arange(1, steps + 1) / steps
        return np.column_stack([np.interp(arc_lengths, travelled, column) for column in polyline.T])

    def _rolled(self, plans: Sequence[tuple[Node, np.ndarray]]) -> list[Node]:
        """Return the nodes after inputs (K, nu), without nodes for which a step fails or passes through a body."""
        nodes, u = [node for node, _ in plans], np.array([inputs for _, inputs in plans])
        S, K = u.shape[:2]
        x = np.full((S, K + 1, self.problem.system.nx), np.nan)
        x[:, 0] = [node.x[-1] for node in nodes]
        alive = np.arange(S)
        self.tried, self.rolled = self.tried + S, self.rolled + S * K
        for k in range(K):
            if not len(alive):
                break
            x[alive, k + 1] = self._step(x[alive, k], u[alive, k])
            alive = alive[np.isfinite(x[alive, k + 1]).all(axis=1)]
            alive = alive[self._penetration_between_nodes(x[alive, k : k + 2]) < DEPTH * self.problem.scales.gap]
        if not len(alive):
            return []
        chosen, x, u = [nodes[s] for s in alive], x[alive], u[alive]
        u_before = np.array([n.u[-1] if len(n.u) else self.limits.u_before for n in chosen])
        cost = np.array([n.cost for n in chosen]) + self._stages(x, u, u_before)
        steps_done = np.array([len(n.u) + K for n in chosen])
        resting = cost + self._cost_at_rest(x[:, -1], steps_done)
        return [
            Node(np.vstack([n.x, x[s, 1:]]), np.vstack([n.u, u[s]]), cost[s], resting[s]) for s, n in enumerate(chosen)
        ]

    def _penetration_between_nodes(self, x: np.ndarray) -> np.ndarray:
        """Return the deepest penetration (S,) on the straight lines between nodes."""
        states_between = [x[:, :-1] * (1 - s) + x[:, 1:] * s for s in SHARES]
        gap = self._distance(np.concatenate(states_between, axis=1).reshape(-1, x.shape[2]))
        gap = gap.reshape(len(x), len(SHARES) * (x.shape[1] - 1), gap.shape[-1])
        return -gap.min(axis=(1, 2), initial=np.inf)

    def _stages(self, x: np.ndarray, u: np.ndarray, before: np.ndarray) -> np.ndarray:
        """Return the sums (S,) of stage costs and penalties for states x (S, K+1, nx) and inputs u (S, K, nu)."""
        du = np.diff(u, axis=1, prepend=before[:, None])
        none = np.zeros((*u.shape[:2], self.problem.system.nlam))
        stage, _ = at_steps(self.problem.cost_terms, x[:, :-1], u, du, none, p=self.evaluation.p)
        violation = at_steps(self._path_violation, x[:, :-1], u, x[:, 1:], p=self.evaluation.p)[0]
        return stage.sum(axis=(1, 2)) + violation.sum(axis=(1, 2))

    @cached_property
    def _path_violation(self) -> ca.Function:
        """Function from (x, u, x_next, p) to the squared violation of path constraints, scaled to a cost."""
        problem, system = self.problem, self.problem.system
        total = ca.SX(0)
        for constraint in problem.path:
            if constraint.name != SWEPT and not ca.depends_on(constraint.expression, system.lam):
                violation = ca.fmax(
                    ca.fmax(constraint.lower - constraint.expression, constraint.expression - constraint.upper), 0
                )
                total += ca.sumsqr(violation)
        total *= problem.scales.cost / float(problem.scales.x[-1]) ** 2
        symbols = [system.x, system.u, system.x_next, problem.parameters.vector]
        return ca.Function("over", symbols, [ca.densify(total)])

    def _cost_at_rest(self, x: np.ndarray, gone: np.ndarray) -> np.ndarray:
        """Return the cost (S,) of staying at rest at states x (S, nx) from step ``gone`` to the end of the horizon."""
        u, none = x[:, None, -self._nu :], np.zeros((len(x), 1, self.problem.system.nlam))
        stage, terminal = at_steps(self.problem.cost_terms, x[:, None], u, 0 * u, none, p=self.evaluation.p)
        return (self.problem.N - gone) * stage[:, 0, 0] + terminal[:, 0, 0]

    def rollout(self, inputs: np.ndarray) -> Rollout | None:
        """Return the rollout of inputs (N, nu) under the model's exact law, or None if a step fails."""
        step = self.problem.exact_step
        x, contacts = [self.first().x], []
        for u in inputs:
            x_next, lam, gap = self._model_step.solved(x[-1], u[None])
            if not np.isfinite(x_next).all():
                return None
            x.append(x_next)
            contacts.append((lam, gap))
        lam, gap = (np.array(array).transpose(1, 0, 2) for array in zip(*contacts, strict=True))
        states = np.array(x).transpose(1, 0, 2)
        return Rollout.from_trajectories(self.evaluation, step, states, inputs[None], lam, gap)

    def padded_inputs(self, node: Node) -> np.ndarray:
        """Return the inputs (N, nu) of a plan, with the last input held until the end."""
        last = node.u[-1] if len(node.u) else self.limits.u_before
        return np.vstack([node.u, np.repeat(last[None], self.problem.N - len(node.u), axis=0)])
