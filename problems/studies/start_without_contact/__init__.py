"""N2: plans and gains from a guess without contact, for five models of the dynamics."""

from problems.studies.start_without_contact.claims import claims
from problems.studies.start_without_contact.data import QUICK, Params, run

NOTES = (
    "Curves: gains K_t, k_t by Adam through each of the five dynamics; thin on the model, thick"
    " replayed under the exact law, the band the range over seeds of data, networks and noise."
    " Noise is in units of the data's standard deviations; half of the data lie near the line"
    " from start to goal.",
    "Bars: input sequences by IPOPT, the object's part of the cost alone: under the exact law"
    " the actuator still goes to its rest. The average over noise of exact steps has kinks at"
    " which no gradient method can end; its plan is found by direct transcription of the same"
    " average and rolled out.",
    "Adam knows no bound on how far a command may be from the actuator; IPOPT's plans keep it.",
)
RESUMES = True

__all__ = ["NOTES", "QUICK", "Params", "claims", "run"]
