"""A3: variance of the first-order gradient over the length of unrolls, machines in training."""

from problems.spec import Citation
from problems.studies.study import Study

study = Study(
    id="A3",
    title="Gradient variance over the unroll length",
    citation=Citation("zhang2023adaptive", "Fig. 3, sec. 7.2; thm. 4.4"),
    folder=__name__,
    notes=(
        "Every law and length differentiates the same policies from the same states, those of a"
        " training through the adaptive law, so that nothing differs but law and length.",
        "The variance is the trace of the covariance of one unroll's gradient, unrolls that are not"
        " finite left out and counted.",
        "Theorem 4.4 with its constant mended (errata, 28): v = O(H^4 (sqrt 2 L_f L_pi)^(4 H)); L_f"
        " is the largest norm of the step's slopes [A B] among the visited states, L_pi the"
        " policy's, in the states' and inputs' own units.",
    ),
    resumes=True,
    quick={"stages": 2, "unrolls": 64},
)
