"""What is stored of a training beside its numbers: units, and an episode to look at."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ocp.learning.experiment import EXACT, Experiment
from ocp.learning.protocol import Normaliser, Trained
from ocp.learning.training import evaluate
from ocp.physics.contact_report import least_slip

if TYPE_CHECKING:
    import xarray as xr

    from dynamics.systems import Signal


def policy_of(data: xr.Dataset | Mapping[str, np.ndarray]) -> Trained:
    """The policy of a stored training: parameters and normaliser, to the last bit."""
    theta, mean, scale = (np.asarray(data[name]) for name in ("theta", "mean", "scale"))
    # In binary numbers the root of the square of a number is that number.
    return Trained(theta, Normaliser(2.0, mean, 2.0 * scale**2))


def described(experiment: Experiment, data: xr.Dataset) -> xr.Dataset:
    """Add units to what :func:`~ocp.learning.training.train` gives, and an episode.

    That is the first one of the evaluations, with the policy that was judged best, under the exact
    law: ``x`` (scenario, node, state), ``u`` (scenario, interval, control), ``lam`` (scenario,
    interval, contact), one scenario, and ``time``, up to the episode's end.
    """
    found = data.drop_attrs().assign(_episode(experiment, policy_of(data)))
    return _with_units(experiment, found)


def _episode(experiment: Experiment, policy: Trained) -> dict[str, Any]:
    task = experiment.task
    seen = evaluate(experiment, policy, EXACT, 1)
    length = int(seen.lengths[0])
    x, u = seen.states[0, : length + 1], seen.inputs[0, :length]
    step = EXACT.close(task.system)
    p = step.p.pack(dict(zip(task.parameters.names, task.parameters.values, strict=True)))
    solved = [[np.array(value).ravel() for value in step.solve(*at, p)[1:3]]
              for at in zip(x, u, strict=False)]  # fmt: skip
    pairs = np.array(solved).reshape(length, 2, step.n)
    lam, _ = least_slip(step, pairs[:, 0], pairs[:, 1])
    of = {"state": task.system.states, "control": task.system.inputs,
          "contact": task.system.contacts}  # fmt: skip
    names = {key: (key, [signal.name for signal in signals]) for key, signals in of.items()}
    units = {f"{key}_unit": (key, [signal.unit for signal in signals])
             for key, signals in of.items()}  # fmt: skip
    return {
        "x": (("scenario", "node", "state"), x[None], _unit("state", of["state"])),
        "u": (("scenario", "interval", "control"), u[None], _unit("control", of["control"])),
        "lam": (
            ("scenario", "interval", "contact"), lam.reshape(1, length, step.n),
            _unit("contact", of["contact"]),
        ),
        **names,
        **units,
        "time": ("node", _h(experiment) * np.arange(length + 1), {"units": "s"}),
    }  # fmt: skip


def _unit(dimension: str, signals: tuple[Signal, ...]) -> dict[str, str]:
    units = {signal.unit for signal in signals}
    return {"units": units.pop() if len(units) == 1 else f"see {dimension}_unit"}


def _h(experiment: Experiment) -> float:
    """Step size [s]."""
    import casadi as ca

    task = experiment.task
    h = ca.Function("h", [task.parameters.vector], [ca.SX(task.system.h)])
    return float(h(task.parameters.values))


def _with_units(experiment: Experiment, data: xr.Dataset) -> xr.Dataset:
    task = experiment.task
    known = {f"evaluation_{measure.signal.name}": measure.signal.unit for measure in task.measures}
    known |= {"wall_s": "s"}
    data = data.assign(
        observation_unit=("observation", [signal.unit for signal in task.observations]),
        physical_unit=("physical", [task.parameters.get(str(name)).unit
                                    for name in data["physical"].values]),
    )  # fmt: skip
    for name in ("mean", "scale"):
        data[name].attrs["units"] = "see observation_unit"
    data["psi"].attrs["units"] = "see physical_unit"
    for name, variable in data.data_vars.items():
        variable.attrs.setdefault("units", known.get(str(name), "1"))
    return data
