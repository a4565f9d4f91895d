"""Studies: one module for each figure of a paper; ``get("P6").data()`` runs one."""

from ocp.errors import choose
from problems.spec import Citation
from problems.studies.study import Claim, FigureStudy

_PAPERS = {
    "N": "suh2023noising",
    "P": "suh2022pathologies",
    "A": "zhang2023adaptive",
    "C": "shirai2024linear",
    "T": "zhang2023adaptive",
}
"""Mapping from the first letter of a study's identifier to the key of its paper in references.bib."""
_FIGURES = (
    ("N0", "theory_of_noising", "Theory of noising data", "lemmas 1 to 3 and sec. IV-C"),
    ("N1", "noised_contact", "What noised data make of contact along a line", "Fig. 1, sec. IV-B and IV-C"),
    ("N2", "start_without_contact", "Pushing and turning from a start without contact", "Fig. 2 and sec. V-B"),
    ("N3", "smoothings_compared", "Which smoothing to trust", "Sec. V-B, and what it leaves open"),
    ("P1", "jumping_objectives", "Three simple systems with jumps", "Fig. 1 and sec. III-A"),
    ("P2", "heaviside_bias", "Gradient estimates of the Heaviside function", "Fig. 2, example III.2"),
    ("P3", "friction_bias", "Coulomb friction and empirical bias", "Fig. 3, example III.5"),
    ("P4", "wall_corner", "A ball against the corner of a wall, and against a dome", "Fig. 4 and example III.6"),
    ("P5", "stiff_pushing", "Pushing through a stiff spring, and without one", "Fig. 5, example III.7 and sec. IV-A"),
    (
        "P6",
        "barrier_relaxation",
        "Implicit time stepping and its log-barrier relaxation",
        "Fig. 6, examples IV.1 and IV.2",
    ),
    (
        "P7",
        "interpolated_gradients",
        "Interpolated gradients: fooled, and not",
        "Sec. IV-C, eq. 6, on examples III.2, III.5, III.6",
    ),
    (
        "A1",
        "adaptive_mu",
        "Contact impulse and adaptive mu over the gap, and their noise",
        "Fig. 1c and 1d, propositions 5.2 and 5.3",
    ),
    ("A2", "bouncing_ball", "A bouncing ball: elastic as an equation, plastic by time stepping", "Fig. 2 and C.1"),
    ("A2v", "landing_variance", "Gradient variance of a landing ball over mu", "Sec. 7.2, the figure beside the text"),
    ("A3", "unroll_variance", "Gradient variance over the unroll length", "Fig. 3, sec. 7.2; thm. 4.4"),
    ("A4", "trained_policies", "Seven ways to train a policy, judged under exact contact", "Fig. 4, sec. 7.3"),
    ("A5", "smoothing_ablation", "Which mu to learn through: the half-cheetah", "Fig. 5, sec. 7.4"),
    ("A6", "impact_and_friction", "Smoothing an impact and smoothing friction", "Fig. 6"),
    ("A7", "thrown_ball", "Throwing a ball: four policy gradients and their landscapes", "Fig. 7a and sec. 7.3"),
    ("AM", "model_learning", "A hopper's next state from few transitions", "Sec. 7, model learning, and eq. 4.1"),
    (
        "AT",
        "convergence_bound",
        "Convergence of policy gradients, beside its bound",
        "Thm. 4.2, on the example of fig. 7a",
    ),
    (
        "C1",
        "laws_in_the_loop",
        "Which smoothing to trust in the loop",
        "The question of its title, and what it leaves open",
    ),
    (
        "T1",
        "audited_theory",
        "The theory audited on random contact problems",
        "Thm. 4.4, 4.5, 5.1, 5.4, prop. 5.2, 5.3; and lemmas III.1, III.4 of Pathologies",
    ),
)
"""Identifier, module, title and place in the paper of every study."""
STUDIES = {
    identifier: FigureStudy(identifier, f"{__name__}.{module}", title, Citation(_PAPERS[identifier[0]], source))
    for identifier, module, title, source in _FIGURES
}
"""Mapping from identifier to study, in the order of the papers."""


def ids() -> list[str]:
    """Return the identifiers of all studies, in the order of the papers."""
    return list(STUDIES)


def get(name: str) -> FigureStudy:
    """Return the study with the identifier ``name``, in upper or lower case.

    Raises :class:`~ocp.errors.InputError` for an unknown name.
    """
    identifiers = {identifier.lower(): identifier for identifier in STUDIES}
    return choose("figure", identifiers.get(name.lower(), name), STUDIES)


__all__ = ["Claim", "FigureStudy", "get", "ids"]
