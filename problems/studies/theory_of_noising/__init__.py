"""N0: what noised data make of a function, computed where its theory can be checked."""

from problems.spec import Citation
from problems.studies.study import Study

study = Study(
    id="N0",
    title="Theory of noising data",
    citation=Citation("suh2023noising", "lemmas 1 to 3 and sec. IV-C"),
    folder=__name__,
    notes=(
        "sigma is in metres along a line, and in deviations of the data in many dimensions.",
        "For f(x) = x a rollout of g_sigma is the mean-shift iteration: it climbs the density of"
        " the noised data.",
        "Networks are trained on a fixed set of noised pairs, so that their number is known; with"
        " fresh noise in every minibatch it grows with the time of training.",
        "Neighbours: (sum w)²/sum w², of which both sums are densities, one of the width"
        " sigma/sqrt(2).",
    ),
)
