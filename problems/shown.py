"""What a run stores of a user's own problem, so that it is shown without the problem's code."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ocp.errors import InputError
from problems.parameters import unit_of

if TYPE_CHECKING:
    from problems.spec import ProblemSpec

MOST_NODES = 20_000
"""Longer motions are not drawn ahead."""


@dataclass(frozen=True)
class Shown:
    """A problem of a user's file at its parameters; an :class:`ocp.problem.Shown`."""

    spec: ProblemSpec
    params: Any

    def told(self, motions: Mapping[str, np.ndarray]) -> dict[str, Any]:
        """Title, equations, parameters, and what is drawn at the states (n, nx) of each motion.

        Of the form of :class:`ocp.store.meta.OwnProblem`. A motion ends with its last finite
        state; ``undrawn`` says why there is no drawing.
        """
        spec = self.spec
        told = {
            "title": spec.title,
            "equations": list(spec.equations),
            "axes": list(spec.axes),
            "parameters": {
                name: {"unit": unit_of(about), "description": about.description or ""}
                for name, about in spec.Params.model_fields.items()
            },
            "motions": {},
            "undrawn": "",
        }
        if spec.draw is None:
            return {**told, "undrawn": "its file has no draw(params, state)"}
        if sum(map(len, motions.values())) > MOST_NODES:
            return {**told, "undrawn": f"its motion has more than {MOST_NODES} nodes"}
        try:
            return {**told, "motions": {key: self._drawn(x) for key, x in motions.items()}}
        except InputError as error:
            return {**told, "undrawn": str(error)}

    def _drawn(self, x: np.ndarray) -> dict[str, Any]:
        spec, known = self.spec, np.isfinite(x).all(axis=1)
        assert spec.draw is not None
        seen = x if known.all() else x[: max(1, int(np.argmin(known)))]
        shapes = [spec.draw(self.params, state) for state in seen]
        contacts = [] if spec.frames is None else [spec.frames(self.params, s) for s in seen]
        return {
            "shapes": [[{"kind": type(s).__name__, **asdict(s)} for s in at] for at in shapes],
            "contacts": [[asdict(contact) for contact in at] for at in contacts],
        }
