"""Where a program is violated, and by how much."""

from __future__ import annotations

import numpy as np

from ocp.program import Program


def violation(
    program: Program, x: np.ndarray, p: np.ndarray, bounds: dict[str, np.ndarray]
) -> tuple[float, str]:
    """Return the largest violation of a bound or constraint at x, and its name."""
    g = np.array(program.f_g(x, p)[1]).ravel()
    worst, name = 0.0, "nothing"
    parts = (("bound on", program.variables, x, "x"), ("constraint", program.constraints, g, "g"))
    for what, layout, values, letter in parts:
        off = np.maximum(bounds[f"lb{letter}"] - values, values - bounds[f"ub{letter}"])
        if off.size and not off.max() <= worst:
            at = int(np.argmax(np.nan_to_num(off, nan=np.inf)))
            block, index = layout.locate(at)
            called = block.components[index[-1]] if block.components else f"{block.name}{[*index]}"
            worst, name = float(off[at]), f"{what} {called}"
    return worst, name
