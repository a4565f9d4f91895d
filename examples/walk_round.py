"""The pusher must walk round its object: its goal moves from before it to behind it.

The program is built once in each of its two reformulations. Every solution starts from the one
before, and the places where contacts change are found on the way.
"""

from dynamics.contact import Exact
from ocp import Continuation, continue_over
from problems import get


def walk() -> Continuation:
    """Follow the exact solution of push-disc along ``goal_x``, from 1 to -1.5 m."""
    return continue_over(get("push-disc"), "goal_x", 1.0, -1.5, steps=20, contact=Exact())


def main() -> None:
    """Print cost and end of the pusher at every goal, and what happened between."""
    curve = walk()
    for point in curve.points:
        x = point.solution.data["x"].sel(scenario=0).isel(node=-1)
        place = f"({float(x.sel(state='ax')):6.3f}, {float(x.sel(state='ay')):6.3f})"
        print(f"goal_x {point.value:7.4f}   cost {point.solution.cost:.6f}   pusher ends at {place}")
    for event in curve.events:
        print(event.describe(curve.parameter))
    print(f"{curve.iterations} iterations, {curve.nlp_builds} programs built")


if __name__ == "__main__":
    main()
