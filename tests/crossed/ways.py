"""Combinations of options and the problems to try them on, both from the program's own tables."""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from dynamics.laws import LAWS
from ocp.mpc.phases import PHASES
from ocp.mpc.plants import PLANTS
from ocp.problem.policy import POLICIES
from ocp.programs.solver import SOLVERS
from ocp.routes.relaxations import STRATEGIES
from ocp.simulators import SIMULATORS
from ocp.transcription import METHODS
from problems import names

STRANGERS = sorted((Path(__file__).parent / "strangers").glob("*.py"))
PROBLEMS = [*names(), *(str(file) for file in STRANGERS)]
LONG_BUILDS = (
    *("quadruped", "ant", "push-cube", "reorient", "half-cheetah", "hopper"),
    *("planar-hand", "planar-push", "cart-transport"),
)
"""Names of the problems on which one case takes seconds to minutes, mostly to build graphs."""
COSTLY = {
    *LONG_BUILDS,
    "idto-hopper",
    *("soft-walls", "finger-disc", "push-t", "spinner"),
    *("two_bodies", "joint_limit", "clashing_names"),
}
"""Names of the problems on which the median time of a case is above a quarter of a second."""
SMALLEST: dict[str, int] = dict.fromkeys(("least_time.py", "periodic.py", "ball-throw", "half-cheetah", "hopper-1d"), 2)
"""Mapping from problem to its smallest horizon, where one step is too short."""
_LIMITS = {"ipopt": "max_iter", "uno": "max_iterations"}
"""Mapping from solver to the name of its iteration limit."""
_ITERATIONS = 3


@dataclass(frozen=True)
class Way:
    """One combination of options: ``loop`` are options of ``ocp mpc``; if empty, the case is a solve."""

    name: str
    solve: dict[str, Any] = field(default_factory=dict)
    world: str = ""
    loop: dict[str, str] = field(default_factory=dict)


EFFORTS = ("normal", "thorough")
"""Efforts beyond the quick one of all other ways, which follows the route of the options that are crossed."""


def _settings(solver: str = "ipopt", **more: Any) -> dict[str, Any]:
    return {_LIMITS.get(solver, "max_iter"): _ITERATIONS, **more}


def ways() -> Iterator[Way]:
    """Yield all combinations of options, each with few iterations."""
    for law, method in itertools.product(LAWS, METHODS):
        yield Way(f"{law}-{method}", {"contact": law, "method": method})
    for policy, law in itertools.product(POLICIES, LAWS):
        yield Way(f"{policy}-{law}", {"policy": policy, "contact": law})
    for policy, method in itertools.product(POLICIES, METHODS):
        yield Way(f"{policy}-{method}", {"policy": policy, "method": method})
    for strategy in STRATEGIES:
        yield Way(strategy, {"settings": _settings(strategy=strategy)})
    for solver in SOLVERS:
        yield Way(f"solver-{solver}", {"solver": solver, "settings": _settings(solver)})
    for homotopy in (True, False):
        settings = _settings(homotopy=homotopy)
        yield Way(f"homotopy-{homotopy}", {"contact": "barrier", "settings": settings})
    for rank in ("planned", "exact", "referee"):
        yield Way(f"two-starts-{rank}", {"n_starts": 2, "rank_by": rank})
    for search in (True, False):
        yield Way(f"search-{search}", {"search": search})
    for effort in EFFORTS:
        yield Way(f"effort-{effort}", {"effort": effort})
    yield Way("refine", {"refine": True})
    yield Way("until-survives", {"until": "survives"})
    for world in SIMULATORS:
        yield Way(f"world-{world}", world=world)
    for phase, law in itertools.product(PHASES, ("own", *LAWS)):
        yield Way(f"mpc-{phase}-{law}", loop={"phase": phase, "contact": law})
    for plant in PLANTS:
        yield Way(f"mpc-on-{plant}", loop={"plant": plant})


@dataclass(frozen=True)
class Crossing:
    """One combination of options on one problem at its smallest size."""

    problem: str
    way: Way

    @property
    def name(self) -> str:
        """Name of the case, which does not depend on the repository's path."""
        return f"{Path(self.problem).stem}:{self.way.name}"

    @property
    def costly(self) -> bool:
        """Whether the problem is slow even at its smallest size."""
        return Path(self.problem).stem in COSTLY

    @property
    def params(self) -> dict[str, int]:
        """Parameters that give the smallest size."""
        return {"N": SMALLEST.get(Path(self.problem).name, 1)}

    def drawn(self, share: int, purpose: str = "") -> bool:
        """Return whether this is one of every ``share`` cases; the choice is always the same."""
        digest = hashlib.sha256(f"{purpose}{self.name}".encode()).digest()
        return int.from_bytes(digest[:4], "big") % share == 0

    @property
    def arguments(self) -> dict[str, Any]:
        """Arguments of :func:`ocp.solve` besides the problem."""
        return {"settings": _settings(), "effort": "quick", **self.way.solve}

    @property
    def words(self) -> list[str]:
        """The case as words of a command line."""
        size = [word for name, value in self.params.items() for word in ("-p", f"{name}={value}")]
        if self.way.loop:
            options = [word for k, v in self.way.loop.items() for word in (f"--{k}", v)]
            return ["mpc", self.problem, *size, *options, "--steps", "2", "--certify", "1"]
        given = {**self.arguments}
        words = [f"{k}={str(v).lower() if isinstance(v, bool) else v}" for k, v in given.pop("settings").items()]
        size += [word for setting in words for word in ("-s", setting)]
        if "search" in given:
            size.append("--search" if given.pop("search") else "--no-search")
        if given.pop("refine", False):
            size.append("--refine")
        if self.way.world:
            size += ["--world", self.way.world]
        flags = {"rank_by": "--rank"}
        options = [w for k, v in given.items() for w in (flags.get(k, f"--{k}"), str(v))]
        return ["solve", self.problem, *size, *options]


CROSSINGS = [Crossing(problem, way) for problem in PROBLEMS for way in ways()]
