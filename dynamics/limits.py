"""Ranges of arguments that functions and options of the command line have in common.

This module imports nothing, so that the program can show its help without delay.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dynamics.settings import Range

COUNT: Range = {"least": 1}
"""Range of a number of items."""
INDEX: Range = {"least": 0}
"""Range of a seed, and of numbers that are counted from 0."""
STARTS: Range = {"least": 1, "most": 10_000}
"""Range of the number of initial guesses of a solve."""
WORKERS: Range = {"least": 1, "most": 1024}
"""Range of the number of parallel processes, and of threads."""
CONTINUATION_STEPS: Range = {"least": 1, "most": 100_000}
"""Range of the number of steps of a continuation."""
LOOP_SAMPLES: Range = {"least": 1, "most": 1_000_000}
"""Range of the number of samples of a closed loop."""
LOOP_SEEDS: Range = {"least": 1, "most": 10_000}
"""Range of the number of seeds of a closed loop's noise."""
QP_ITERATIONS: Range = {"least": 1, "most": 1000}
"""Range of the number of quadratic programs that a controller solves per sample."""
QP_BUDGET: Range = {"least": 1, "most": 1_000_000}
"""Range of the maximum number of iterations of quadratic programs per sample."""
TRUST: Range = {"above": 0, "most": 1}
"""Range of the weight of a measured state relative to the predicted state."""
EPISODES: Range = {"least": 1, "most": 1_000_000}
"""Range of the number of episodes of an evaluation."""
