"""Label trajectories: names, units and times on every array."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dynamics.systems import Signal
from ocp.audit import Trajectories, signed_distances
from ocp.contact_book import ContactBook, contact_book
from ocp.problem import Problem
from ocp.rollout import Rollout
from ocp.routes.outcome import Outcome
from ocp.transcription.nlp import NLP
from ocp.warm_start import multipliers, node_times

if TYPE_CHECKING:
    import xarray as xr


def label(
    nlp: NLP,
    plan: Trajectories,
    replay: Rollout,
    book: ContactBook,
    outcome: Outcome,
    values: dict[str, float],
    refereed: Rollout,
) -> xr.Dataset:
    """Return the dataset that :class:`~ocp.solution.Solution` documents."""
    import xarray as xr

    problem = nlp.problem
    physical = np.array([values[name] for name in problem.parameters.names])
    data = xr.Dataset(coords=_coordinates(nlp, physical, plan.x[0, 0]))
    along = ("scenario", "interval")
    data["x"] = (("scenario", "node", "state"), plan.x)
    data["u"] = ((*along, "control"), plan.u)
    for name in ("lam", "gap", "mu"):
        data[name] = ((*along, "contact"), getattr(plan, name))
    data["x_replay"] = (("scenario", "node", "state"), replay.x)
    data["u_replay"] = ((*along, "control"), replay.u)
    data["x_referee"] = (("scenario", "node", "state"), refereed.x)
    data["u_referee"] = ((*along, "control"), refereed.u)
    data["lam_replay"] = ((*along, "contact_exact"), replay.lam)
    data["gap_replay"] = ((*along, "contact_exact"), replay.gap)
    for name, x in (("phi", plan.x), ("phi_replay", replay.x)):
        phi = signed_distances(problem, x, physical)
        if phi is not None:
            data[name] = (("scenario", "node", "distance"), phi)
    if problem.system.forces is not None:
        _add_forces(data, book, _exact_book(problem, replay, physical))
    if plan.gains is not None:
        N = problem.N
        K = np.broadcast_to(plan.gains.K, (N, *plan.gains.K.shape[1:]))
        k = np.broadcast_to(plan.gains.k, (N, *plan.gains.k.shape[1:]))
        data["K"] = (("interval", "control", "state"), K)
        data["k"] = (("interval", "control"), k)
    data = data.assign(multipliers(nlp, outcome.result.point))
    _add_stages(data, nlp, outcome)
    _add_units(data, problem)
    return data


def _exact_book(problem: Problem, replay: Rollout, physical: np.ndarray) -> ContactBook:
    """Keep the books of a replay under the exact law."""
    step = problem.exact_step
    return contact_book(problem, step, replay.x, replay.u, replay.lam, replay.gap, physical)


def _add_forces(data: xr.Dataset, planned: ContactBook, exact: ContactBook) -> None:
    data.coords["point"] = list(planned.names)
    for suffix, book in (("", planned), ("_replay", exact)):
        parts = (
            ("normal_impulse", book.normal, "N s"),
            ("friction_impulse", book.tangential, "N s"),
            ("slip", book.slip, "m/s"),
            ("friction_bound", book.bound, "N s"),
            ("acts", book.acts, "1"),
            ("slides", book.slides, "1"),
            ("weak", book.weak, "1"),
        )
        for name, values, unit in parts:
            dims = ("scenario", "interval", "point")
            data[f"{name}{suffix}"] = (dims, np.asarray(values, dtype=float), {"units": unit})


def _names(signals: tuple[Signal, ...]) -> list[str]:
    return [signal.name for signal in signals]


def _coordinates(nlp: NLP, physical: np.ndarray, start: np.ndarray) -> dict[str, object]:
    problem, system = nlp.problem, nlp.problem.system
    time = node_times(problem, physical, start)
    return {
        "state": _names(system.states),
        "control": _names(system.inputs),
        "contact": _names(nlp.step.contacts),
        "contact_exact": _names(system.contacts),
        "time": ("node", time, {"units": "s"}),
        "time_interval": ("interval", time[:-1], {"units": "s"}),
    }


def _add_stages(data: xr.Dataset, nlp: NLP, outcome: Outcome) -> None:
    records = outcome.trace.records
    data["stage_knob"] = ("stage", [record.knob for record in records])
    data["stage_status"] = ("stage", [record.status for record in records])
    for name in ("value", "cost", "complementarity", "residual", "iterations", "seconds"):
        data[f"stage_{name}"] = ("stage", [getattr(record, name) for record in records])
    kept = [nlp.variables.unpack(x) for _, x in outcome.trace.points if x.size == nlp.n]
    for block in ("x", "u"):
        if kept and block in nlp.variables:
            stack = np.stack([blocks[block] for blocks in kept])
            last = {"x": "state", "u": "control"}[block]
            rows = "scenario" if stack.shape[1] == data.sizes["scenario"] else "shared"
            data[f"stage_{block}"] = (("accepted_stage", rows, "interval", last), stack)


def _add_units(data: xr.Dataset, problem: Problem) -> None:
    system = problem.system
    units = {
        "state": [signal.unit for signal in system.states],
        "control": [signal.unit for signal in system.inputs],
        "contact_exact": [signal.unit for signal in system.contacts],
    }
    branches = data.sizes["contact"] // max(1, system.nlam)
    units["contact"] = units["contact_exact"] * branches
    for dimension, values in units.items():
        data[f"{dimension}_unit"] = (dimension, values)
    per_entry = {
        "x": "state_unit", "x_replay": "state_unit", "x_referee": "state_unit",
        "u": "control_unit", "u_referee": "control_unit",
        "u_replay": "control_unit", "lam": "contact_unit", "lam_replay": "contact_exact_unit",
    }  # fmt: skip
    contact_unit = system.contacts[0].unit if system.contacts else "1"
    simple = {"gap": system.gap_unit, "gap_replay": system.gap_unit, "phi": "m",
              "phi_replay": "m", "mu": f"{contact_unit} {system.gap_unit}"}  # fmt: skip
    for name, variable in data.data_vars.items():
        key = str(name)
        if key in per_entry:
            dimension = per_entry[key]
            found = sorted(set(data[dimension].values.tolist()))
            variable.attrs["units"] = found[0] if len(found) == 1 else f"see {dimension}"
        elif key in simple:
            variable.attrs["units"] = simple[key]
        elif key == "stage_seconds":
            variable.attrs["units"] = "s"
        else:
            variable.attrs.setdefault("units", "1")
