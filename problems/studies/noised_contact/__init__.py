"""N1: models of a pushed block and of a block between walls, learned from sparse or dense noised data."""

from problems.studies.noised_contact.claims import claims
from problems.studies.noised_contact.data import QUICK, Params, run

NOTES = (
    "The paper gives no numbers: the pusher's spring is stiff, so that the slope in contact is"
    " 0.99; data are uniform and random, 10 and 1000 commands, 5 and 1000 states.",
    "In contact the slope is rho = h² K/(m + h² K), not 1.",
    "Networks: two layers, fresh noise in every minibatch; the rms in the legend is of the"
    " network drawn against the average, over the density of the noised data.",
    "What depends on which data were drawn is judged over many sets of them, and networks over"
    " several starts of their weights.",
)

__all__ = ["NOTES", "QUICK", "Params", "claims", "run"]
