"""Options of ``ocp mpc``."""

from __future__ import annotations

from typing import ClassVar

from dynamics.limits import INDEX, LOOP_SAMPLES, LOOP_SEEDS, QP_BUDGET, QP_ITERATIONS, TRUST
from reports.cli.options.shared import ProblemOptions, assignment, option


class MpcOptions(ProblemOptions):
    """Simulate a receding-horizon controller on a plant, and store the closed loop as a run.

    The plant may differ from the model: finer steps, noise, other parameters, a delay, pushes. Each
    seed has its own noise. After Ctrl-C the samples so far are stored.
    """

    code: ClassVar = "reports.cli.mpc_command"
    examples: ClassVar = (
        "mpc soft-walls -p N=10 --steps 200 --pdf loop.pdf",
        "mpc soft-walls --plant h/4 --noise-state 0.01 --mismatch mp=0.5 --seeds 5",
        "mpc soft-walls --phase relaxed -c mu=1e-3 --push 20:dp=0.5 --rate 200",
        "mpc soft-walls --plan @last --push 5:dp=0.5",
    )
    contact: str = option(
        "own",
        "--contact",
        "--law",
        help="Contact law of the plans; own: exact, for phase relaxed barrier with mu=1e-2.",
    )
    phase: str = option("qpcc", help="qpcc, qp, relaxed, full or policy.")
    plant: str = option("exact", help="exact, referee, h/4, noise or mujoco.")
    steps: int | None = option(None, limits=LOOP_SAMPLES, help="Samples; default: the larger of 100 and the horizon.")
    plan: str | None = option(None, metavar="RUN", help="Track the plan of this run until its end.")
    rate: float | None = option(None, metavar="HZ", help="Rate of samples, a multiple of 1/h; default: 1/h.")
    iterations: int = option(1, limits=QP_ITERATIONS, help="Quadratic programs per sample.")
    budget: int | None = option(None, limits=QP_BUDGET, help="Iterations of these programs per sample at most.")
    trust: float = option(1.0, limits=TRUST, help="Weight of the measured state against the predicted one, in (0, 1].")
    deadline: float | None = option(
        None, metavar="S", help="Replace answers that take longer by the input of the previous plan."
    )
    noise_state: list[str] | None = option(None, metavar="X|NAME=X", help="Standard deviation of the measured state.")
    noise_input: list[str] | None = option(None, metavar="X|NAME=X", help="Standard deviation of the applied input.")
    mismatch: list[str] | None = assignment(help="Value of a parameter of the plant alone.")
    delay: bool = option(False, help="Apply each input one sample late.")
    push: list[str] | None = option(None, metavar="K:NAME=X", help="Change of a state before sample K.")
    seeds: int = option(1, limits=LOOP_SEEDS, help="Number of seeds of the noise.")
    certify: int = option(0, limits=INDEX, metavar="N", help="Judge every Nth plan; 0: none.")
