"""Drawings of the studies, by the study's identifier."""

from reports.figures.studies import (
    learned_laws,
    noising,
    pathologies,
    policies,
    smoothing,
)
from reports.figures.studies.panels import Drawing

DRAWINGS: dict[str, Drawing] = {
    "N0": noising.N0,
    "N1": noising.N1,
    "N2": learned_laws.N2,
    "N3": learned_laws.N3,
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
    "AM": learned_laws.AM,
    "AT": policies.AT,
    "T1": smoothing.T1,
}
