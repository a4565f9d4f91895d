"""P3: Coulomb friction relaxed within a slip tolerance, and its empirical bias."""

from problems.spec import Citation
from problems.studies.study import Study

study = Study(
    id="P3",
    title="Coulomb friction and empirical bias",
    citation=Citation("suh2022pathologies", "Fig. 3, example III.5"),
    folder=__name__,
    notes=(
        "The relaxation is one of the sign, 2 H - 1, not of H.",
        "Ex. III.5 has its gradient zero with probability at least c nu: true for small nu, where"
        " it is zero nearly always, and too little for the triple, which needs 1 - c nu.",
        "The closed form of F in the text is that of neither; the one used here is checked by"
        " quadrature.",
        "Behind it a block of 100 kg dragged from rest by a belt with at most 5 N for 0.1 s.",
    ),
)
