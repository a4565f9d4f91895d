"""A1: mu(z) and lam(z) of one contact, and the noise that each softening stands for."""

from problems.spec import Citation
from problems.studies.study import Study

study = Study(
    id="A1",
    title="Contact impulse and adaptive mu over the gap, and their noise",
    citation=Citation("zhang2023adaptive", "Fig. 1c and 1d, propositions 5.2 and 5.3"),
    folder=__name__,
    notes=(
        "mu(z) is the corrected eq. 5.1: kappa = (sigma pdf(z/sigma) - z tail(z/sigma))/F and"
        " mu = kappa (z + F kappa).",
        "The heavy tail of Student's t is the force at a distance of constant mu.",
        "Of the constant mu drawn the caption names 0.1, the others are our choice; its sigma is"
        " not told, so what depends on sigma is judged over a range of it.",
    ),
)
