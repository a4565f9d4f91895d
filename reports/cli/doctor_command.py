"""``ocp doctor``: versions, solvers and compiler of this computer, and the folders of the packages."""

from __future__ import annotations

import os
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import Any

import casadi as ca

from dynamics.batch.engines import compiler
from ocp.distribution import PACKAGES, shadowing
from ocp.errors import InputError
from ocp.programs.solver import SOLVERS
from ocp.store.provenance import versions
from reports.cli.commands import DoctorOptions

LINEAR_SOLVERS = ("mumps", "spral")
"""Linear solvers of IPOPT that ``ocp doctor`` tries."""


def check(options: DoctorOptions) -> dict[str, Any]:
    """Return the folders of the four packages, and names in the working directory that hide one of them."""
    roots = {name: str(Path(import_module(name).__path__[0]).parent) for name in PACKAGES}
    hidden = shadowing(PACKAGES, Path.cwd())
    return {"root": common_root(roots), "roots": roots, "scripts here": hidden or "no name hidden"}


def run(options: DoctorOptions, locations: dict[str, Any]) -> int:
    """Show CasADi's plugins, the compiler, threads, versions, and the location of the packages."""
    count = compiler.clear_cache() if options.clear_cache else None
    installation = {**locations, **describe_computer()}
    if count is not None:
        installation["cleared"] = count
        objects = "1 compiled object" if count == 1 else f"{count} compiled objects"
        options.output.say(f"{objects} removed from the kernel cache")
    options.output.document(installation)
    if not options.as_json:
        for key, value in installation.items():
            if key not in ("roots", "cleared"):
                print(f"{key:<16} {_text(value)}")
    return 0


def common_root(roots: dict[str, str]) -> str:
    """Return the folder that contains all packages; raises InputError if they are in different folders."""
    if len(set(roots.values())) > 1:
        locations = ", ".join(f"{name} from {root}" for name, root in roots.items())
        raise InputError(
            f"the four packages come from different places: {locations}; a file or folder of yours, or"
            " another distribution, has the name of a package: rename yours, or install centralpath"
            " in its own environment"
        )
    return next(iter(roots.values()))


def describe_computer() -> dict[str, Any]:
    """Return versions, threads, plugins that can be loaded, the compiler, and the cache of kernels."""
    return {
        "versions": {**versions(), **{n: version(n) for n in ("matplotlib", "typst", "typer")}},
        "threads": len(os.sched_getaffinity(0)),
        "solvers": {name: ca.has_nlpsol(name) for name in SOLVERS},
        "linear_solvers": {name: _linear_solver_works(name) for name in LINEAR_SOLVERS},
        "kernels": compiler.compiler_info(),
    }


def _linear_solver_works(name: str) -> bool:
    """Return whether IPOPT with this linear solver solves a problem of one variable."""
    x = ca.MX.sym("x")
    quiet = {"print_level": 0, "sb": "yes", "linear_solver": name}
    try:
        solver = ca.nlpsol("probe", "ipopt", {"x": x, "f": (x - 1) ** 2}, {"ipopt": quiet, "print_time": False})
        minimiser = float(solver(x0=0)["x"])
    except RuntimeError:
        return False
    return bool(solver.stats()["success"]) and abs(minimiser - 1) < 1e-6


def _text(value: Any) -> str:
    if isinstance(value, dict):
        return "\n                 ".join(f"{key:<15} {_text(item)}" for key, item in value.items())
    if isinstance(value, bool):
        return "yes" if value else "no"
    return ", ".join(map(str, value)) if isinstance(value, list) else str(value)
