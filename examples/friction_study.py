"""A study of one's own: what friction costs on a slope, and what a plan made with smoothing misses.

The problem is ``slope.py`` beside this file. Two curves are followed over the friction of the
slope, one under the exact law and one under the log-barrier law; the plans of the latter are
replayed under exact contact. ``python examples/friction_study.py OUT`` writes the data and the
figure to the folder OUT.
"""

import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import xarray as xr

from dynamics.contact import Barrier, ContactLaw, Exact
from ocp import continue_over
from problems import get

SLOPE = str(Path(__file__).with_name("slope.py"))
LAWS: dict[str, ContactLaw] = {"exact": Exact(), "barrier": Barrier(mu=1e-3)}
LEAST, MOST, STEPS = 0.4, 0.8, 8


def followed(law: ContactLaw) -> xr.Dataset:
    """Planned cost and cost under exact contact over the friction of the slope."""
    curve = continue_over(get(SLOPE), "friction", LEAST, MOST, STEPS, contact=law)
    costs = [(p.solution.cost, p.solution.audit.exact_cost) for p in curve.points]
    planned, exact = np.transpose(costs)
    return xr.Dataset(
        {"planned": ("friction", planned), "exact": ("friction", exact)},
        coords={"friction": [p.value for p in curve.points]},
    )


def drawn(curves: dict[str, xr.Dataset]) -> plt.Figure:
    """Planned costs as lines, what the same inputs cost under exact contact as crosses."""
    figure, axes = plt.subplots(figsize=(5, 3.2), layout="constrained")
    for name, curve in curves.items():
        (line,) = axes.plot(curve.friction, curve.planned, label=f"{name}, planned")
        axes.plot(curve.friction, curve.exact, "x", color=line.get_color(), label=f"{name}, under exact contact")
    axes.set_xlabel("friction of the slope [1]")
    axes.set_ylabel("cost [1]")
    axes.set_yscale("log")
    axes.legend(frameon=False, fontsize=8)
    return figure


def main() -> None:
    """Follow both curves, store the data, draw the figure."""
    out = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
    out.mkdir(parents=True, exist_ok=True)
    curves = {name: followed(law) for name, law in LAWS.items()}
    for name, curve in curves.items():
        curve.to_netcdf(out / f"friction-{name}.nc")
        print(
            f"{name}: cost {float(curve.planned[0]):.4g} at friction {LEAST},"
            f" {float(curve.planned[-1]):.4g} at {MOST}; under exact contact"
            f" {float(curve.exact[0]):.4g} and {float(curve.exact[-1]):.4g}"
        )
    drawn(curves).savefig(out / "friction.png", dpi=150)


if __name__ == "__main__":
    main()
