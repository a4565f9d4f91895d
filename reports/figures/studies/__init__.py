"""Drawings of the studies, by the study's identifier."""

from reports.figures.studies import (
    model_learning,
    noised_contact,
    pathologies,
    policies,
    smoothing,
    smoothings_compared,
    start_without_contact,
    theory_of_noising,
)
from reports.figures.studies.panels import Drawing

DRAWINGS: dict[str, Drawing] = {
    "N0": theory_of_noising.DRAWING,
    "N1": noised_contact.DRAWING,
    "N2": start_without_contact.DRAWING,
    "N3": smoothings_compared.DRAWING,
    "P1": pathologies.P1,
    "P2": pathologies.P2,
    "P3": pathologies.P3,
    "P4": pathologies.P4,
    "P5": pathologies.P5,
    "P6": pathologies.P6,
    "P7": pathologies.P7,
    "A1": smoothing.A1,
    "A2": smoothing.A2,
    "A2v": smoothing.A2V,
    "A3": policies.A3,
    "A4": policies.A4,
    "A5": policies.A5,
    "A6": smoothing.A6,
    "A7": policies.A7,
    "AM": model_learning.DRAWING,
    "AT": policies.AT,
    "T1": smoothing.T1,
}
