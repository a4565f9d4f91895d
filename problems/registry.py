"""Look-up of problems and static objectives by name, and of problems and contact laws in users' files."""

from __future__ import annotations

import importlib
import re
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from dynamics.contact import ContactLaw
from dynamics.settings import settings_of
from dynamics.systems import ParameterTable, Signal
from ocp.errors import InputError, choose, did_you_mean
from ocp.problem.problem import Problem
from ocp.validation import expand_path
from problems.loading import check, check_file, import_file, read, read_law
from problems.parameters import Parameters, table
from problems.source_digest import source_digest
from problems.spec import ProblemSpec, Spec, spec_from_module

if TYPE_CHECKING:
    from ocp.gradients.objective import ClosedForm, StaticObjective

PROBLEM_MODULES = {
    "wall-1d": "problems.library.wall_1d",
    "push-1d": "problems.library.push_1d",
    "push-disc": "problems.library.push_disc",
    "ball-bounce": "problems.library.ball_bounce",
    "cart-walls": "problems.library.cart_walls",
    "box-slide": "problems.library.box_slide",
    "ball-throw": "problems.library.ball_throw",
    "cart-transport": "problems.library.cart_transport",
    "hopper-1d": "problems.library.hopper_1d",
    "planar-push": "problems.library.planar_push",
    "planar-hand": "problems.library.planar_hand",
    "hopper": "problems.bodies.hopper.problem",
    "half-cheetah": "problems.bodies.half_cheetah.problem",
    "push-box": "problems.library.push_box",
    "push-t": "problems.library.push_t",
    "soft-walls": "problems.library.soft_walls",
    "spinner": "problems.bodies.finger.spinner",
    "finger-disc": "problems.bodies.finger.finger_disc",
    "idto-hopper": "problems.bodies.idto_hopper",
    "quadruped": "problems.bodies.quadruped",
    "ant": "problems.bodies.ant",
    "push-cube": "problems.library.push_cube",
    "reorient": "problems.library.reorient",
}
"""Mapping from the name of a problem to its module, in the order in which problems are listed."""
ARENA_MODULES = {
    "pushbot": "problems.arena.pushbot",
    "transport": "problems.arena.transport",
    "waiter": "problems.arena.waiter",
    "stance-hopper": "problems.arena.stance_hopper",
    "cartpole-friction": "problems.arena.cartpole_friction",
    "acrobot-stops": "problems.arena.acrobot_stops",
    "pushing-obstacle": "problems.arena.pushing_obstacle",
    "discs-swap": "problems.arena.discs_swap",
    "discs-around": "problems.arena.discs_around",
    "drone-tether": "problems.arena.drone_tether",
    "push-recovery": "problems.arena.push_recovery",
}
"""Mapping from the name of a public task of other programs to its module, in the order in which tasks are listed."""
ROBOT_FILES = (".urdf", ".xacro", ".sdf", ".xml", ".mjcf")
"""File extensions of robot descriptions."""
READING_ATTEMPTS = 3
"""Maximum number of attempts to read a file that changes while it is read, for example by writing its own data."""


def names() -> list[str]:
    """Return the names of the problems that ship with the workbench."""
    return list(PROBLEM_MODULES)


def arena_names() -> list[str]:
    """Return the names of the public tasks that ship with the workbench (:mod:`problems.arena`)."""
    return list(ARENA_MODULES)


def titles(modules: Mapping[str, str]) -> dict[str, str]:
    """Return the titles of modules of this package, by name, read from their source: imports take far longer."""
    root = Path(__file__).resolve().parents[1]
    files = {name: root.joinpath(*module.split(".")).with_suffix(".py") for name, module in modules.items()}
    sources = {name: file.read_text(encoding="utf-8") for name, file in files.items()}
    return {name: re.findall(r'^title = "(.+)"$', source, re.MULTILINE)[0] for name, source in sources.items()}


def spec(name: str) -> ProblemSpec:
    """Return the problem called ``name``, or the problem that the file ``name`` (``*.py``) defines.

    Raises :class:`~ocp.errors.InputError` if there is no such problem or file.
    """
    return load(name) if name.endswith(".py") else registered(name)


@cache
def registered(name: str) -> ProblemSpec:
    """Return the problem or arena task called ``name`` that ships with the workbench, without loading any file.

    Raises :class:`~ocp.errors.InputError` for an unknown name.
    """
    _require_known(name, names())
    return spec_from_module(ProblemSpec, importlib.import_module({**PROBLEM_MODULES, **ARENA_MODULES}[name]))


def _require_known(name: str, known_names: list[str]) -> None:
    refuse_robot_file(name)
    if name not in known_names and name not in ARENA_MODULES:
        suggestion = did_you_mean(name, [*known_names, *ARENA_MODULES])
        raise InputError(
            f"unknown problem {name!r}{suggestion}; there are {', '.join(known_names)}, those of ocp list arena, or"
            " give the path of a file such as my_problem.py"
        )


def refuse_robot_file(name: str) -> None:
    """Raise :class:`~ocp.errors.InputError` if ``name`` is the file of a robot, since such a file has no problem."""
    if name.lower().endswith(ROBOT_FILES):
        raise InputError(
            f"{name}: a robot's file defines no problem; ocp new NAME --robot FILE"
            " writes a problem for a URDF or MJCF file, and ocp show FILE lists what is read"
        )


def get(name: str | Parameters, **params: Any) -> Problem:
    """Build the problem ``name`` with ``params`` and the defaults of its other parameters.

    ``name`` can also be the problem's ``Params``, with completion in editors and type checks:
    ``get(push_disc.Params(M=2.0))``.

    Raises :class:`~ocp.errors.InputError` for an unknown name or a bad parameter.
    """
    if isinstance(name, str):
        return spec(name).problem(params)
    module = sys.modules[type(name).__module__]
    if not isinstance(name, Parameters) or getattr(module, "Params", None) is not type(name):
        raise InputError(f"a problem is a name, a file, or the Params of one, got {type(name).__name__}")
    return spec_from_module(ProblemSpec, module).problem({**name.model_dump(), **params})


def load(path: str | Path) -> ProblemSpec:
    """Read a problem from a user's file.

    The file defines ``name``, ``title``, ``Params`` (a pydantic model, :mod:`problems.parameters`)
    and ``build(params) -> Problem``, and may define ``equations``, ``draw``, ``frames``, ``axes``,
    ``golden``, ``citation`` and ``region``, as the modules of :mod:`problems.library` do.

    Raises :class:`~ocp.errors.InputError` if there is no such file, if it raises (the message has the
    line), if a name is missing or has the wrong type, or if the problem's dimensions are inconsistent.
    """
    file = expand_path(path).resolve()
    check_file(file)
    module, digest = _imported(file)
    problem_spec = read(module, file, digest)
    check(problem_spec)
    return problem_spec


_laws: dict[Path, type[ContactLaw]] = {}
"""Mapping from a user's file to the contact law that was last read from this file."""


def load_law(path: str | Path) -> type[ContactLaw]:
    """Read the contact law of a user's file; the file is imported again only if it has changed.

    The file defines one class derived from :class:`dynamics.contact.ContactLaw`, as
    ``examples/logistic.py`` does.

    Raises :class:`~ocp.errors.InputError` as :func:`problems.loading.read_law` does, and if there is
    no such file or it raises.
    """
    file = expand_path(path).resolve()
    check_file(file)
    if file not in _laws or _laws[file].source_digest != source_digest(file):
        module, digest = _imported(file)
        _laws[file] = read_law(module, file, digest)
    return _laws[file]


def _imported(file: Path) -> tuple[ModuleType, str]:
    """Import a file; return its module, and the digest of the file and all that it depends on."""
    earlier_digest, attempts = source_digest(file), 1
    module = import_file(file)
    # If the file changed during the import, it is unknown which version was imported.
    while (digest := source_digest(file)) != earlier_digest and attempts < READING_ATTEMPTS:
        earlier_digest, attempts = digest, attempts + 1
        module = import_file(file)
    return module, digest


OBJECTIVE_MODULES = {
    "heaviside": "problems.library.heaviside",
    "coulomb": "problems.library.coulomb",
    "belt-block": "problems.library.belt_block",
    "ball-wall": "problems.library.ball_wall",
}
"""Mapping from the name of a static objective to its module."""
DECISION = "theta"
"""Name of an objective's decision variable among its parameters."""
NOISE = "sigma"
"""Name of the standard deviation of the noise on the decision among an objective's parameters."""


@dataclass(frozen=True, kw_only=True)
class ObjectiveSpec(Spec):
    """Specification of a static objective; its ``Params`` include the decision ``theta`` and the noise ``sigma``.

    ``cost(params, theta, p)`` returns an expression in the symbol of the decision and the symbols
    ``p`` of the other parameters; ``closed_form(values, sigma)`` returns its exact moments.
    """

    cost: Callable[[Any, ca.SX, ParameterTable], ca.SX]
    closed_form: Callable[[dict[str, float], float], ClosedForm] | None = None

    def objective(self, values: Mapping[str, Any] | None = None, **engine: Any) -> StaticObjective:
        """Build the objective at ``values``, with other parameters at their defaults.

        ``engine`` can set ``backend``, ``threads`` and ``block`` of
        :class:`dynamics.batch.BatchFunction`; raises as :meth:`params` does.
        """
        from ocp.gradients.objective import StaticObjective

        params = self.params(values or {})
        p = ParameterTable(q for q in table(params) if q.name not in (DECISION, NOISE))
        decision, theta = settings_of(self.Params)[DECISION], ca.SX.sym(DECISION)
        return StaticObjective(
            self.name,
            (Signal(DECISION, decision.unit, decision.meaning),),
            theta,
            self.cost(params, theta, p),
            np.array([getattr(params, DECISION)]),
            p,
            self.closed_form,
            **engine,
        )

    @property
    def golden(self) -> dict[str, Any]:
        """Empty mapping of known optima, since an objective is sampled and not solved."""
        return {}


def named(name: str) -> ObjectiveSpec | ProblemSpec:
    """Return the objective or the contact problem called ``name``, or a problem from a file.

    Raises :class:`~ocp.errors.InputError` for an unknown name.
    """
    if name in OBJECTIVE_MODULES:
        return objective_spec(name)
    if not name.endswith(".py"):
        _require_known(name, [*names(), *OBJECTIVE_MODULES])
    return spec(name)


def objective_names() -> list[str]:
    """Return the names of the static objectives."""
    return list(OBJECTIVE_MODULES)


@cache
def objective_spec(name: str) -> ObjectiveSpec:
    """Return the objective called ``name``; raises :class:`~ocp.errors.InputError` if it is unknown."""
    return spec_from_module(ObjectiveSpec, importlib.import_module(choose("objective", name, OBJECTIVE_MODULES)))
