"""Drawings of the studies, by the study's identifier."""

from reports.figures.studies import in_the_loop, learned_laws, noising, pathologies, policies, smoothing
from reports.figures.studies.panels import Drawing

DRAWINGS: dict[str, Drawing] = {
    "N0": noising.n0,
    "N1": noising.n1,
    "N2": learned_laws.n2,
    "N3": learned_laws.n3,
    "P1": pathologies.p1,
    "P2": pathologies.p2,
    "P3": pathologies.p3,
    "P4": pathologies.p4,
    "P5": pathologies.p5,
    "P6": pathologies.p6,
    "P7": pathologies.p7,
    "A1": smoothing.a1,
    "A2": smoothing.a2,
    "A2v": smoothing.a2v,
    "A3": policies.a3,
    "A4": policies.a4,
    "A5": policies.a5,
    "A6": smoothing.a6,
    "A7": policies.a7,
    "AM": learned_laws.am,
    "AT": policies.at,
    "C1": in_the_loop.c1,
    "T1": smoothing.t1,
}
"""Drawing of each study by its identifier."""
