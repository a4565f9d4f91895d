"""Studies: one module for each figure of a paper; ``get("P6").data()`` runs one."""

from ocp.errors import choose
from problems.spec import Citation
from problems.studies.study import Claim, FigureStudy

# Keys of the papers in references.bib.
_NOISING = "suh2023noising"
_PATHOLOGIES = "suh2022pathologies"
_SMOOTHING = "zhang2023adaptive"
_LINEAR = "shirai2024linear"
_FIGURES = (
    ("N0", "problems.studies.theory_of_noising", "Theory of noising data", _NOISING, "lemmas 1 to 3 and sec. IV-C"),
    (
        "N1",
        "problems.studies.noised_contact",
        "What noised data make of contact along a line",
        _NOISING,
        "Fig. 1, sec. IV-B and IV-C",
    ),
    (
        "N2",
        "problems.studies.start_without_contact",
        "Pushing and turning from a start without contact",
        _NOISING,
        "Fig. 2 and sec. V-B",
    ),
    (
        "N3",
        "problems.studies.smoothings_compared",
        "Which smoothing to trust",
        _NOISING,
        "Sec. V-B, and what it leaves open",
    ),
    (
        "P1",
        "problems.studies.jumping_objectives",
        "Three simple systems with jumps",
        _PATHOLOGIES,
        "Fig. 1 and sec. III-A",
    ),
    (
        "P2",
        "problems.studies.heaviside_bias",
        "Gradient estimates of the Heaviside function",
        _PATHOLOGIES,
        "Fig. 2, example III.2",
    ),
    (
        "P3",
        "problems.studies.friction_bias",
        "Coulomb friction and empirical bias",
        _PATHOLOGIES,
        "Fig. 3, example III.5",
    ),
    (
        "P4",
        "problems.studies.wall_corner",
        "A ball against the corner of a wall, and against a dome",
        _PATHOLOGIES,
        "Fig. 4 and example III.6",
    ),
    (
        "P5",
        "problems.studies.stiff_pushing",
        "Pushing through a stiff spring, and without one",
        _PATHOLOGIES,
        "Fig. 5, example III.7 and sec. IV-A",
    ),
    (
        "P6",
        "problems.studies.barrier_relaxation",
        "Implicit time stepping and its log-barrier relaxation",
        _PATHOLOGIES,
        "Fig. 6, examples IV.1 and IV.2",
    ),
    (
        "P7",
        "problems.studies.interpolated_gradients",
        "Interpolated gradients: fooled, and not",
        _PATHOLOGIES,
        "Sec. IV-C, eq. 6, on examples III.2, III.5, III.6",
    ),
    (
        "A1",
        "problems.studies.adaptive_mu",
        "Contact impulse and adaptive mu over the gap, and their noise",
        _SMOOTHING,
        "Fig. 1c and 1d, propositions 5.2 and 5.3",
    ),
    (
        "A2",
        "problems.studies.bouncing_ball",
        "A bouncing ball: elastic as an equation, plastic by time stepping",
        _SMOOTHING,
        "Fig. 2 and C.1",
    ),
    (
        "A2v",
        "problems.studies.landing_variance",
        "Gradient variance of a landing ball over mu",
        _SMOOTHING,
        "Sec. 7.2, the figure beside the text",
    ),
    (
        "A3",
        "problems.studies.unroll_variance",
        "Gradient variance over the unroll length",
        _SMOOTHING,
        "Fig. 3, sec. 7.2; thm. 4.4",
    ),
    (
        "A4",
        "problems.studies.trained_policies",
        "Seven ways to train a policy, judged under exact contact",
        _SMOOTHING,
        "Fig. 4, sec. 7.3",
    ),
    (
        "A5",
        "problems.studies.smoothing_ablation",
        "Which mu to learn through: the half-cheetah",
        _SMOOTHING,
        "Fig. 5, sec. 7.4",
    ),
    ("A6", "problems.studies.impact_and_friction", "Smoothing an impact and smoothing friction", _SMOOTHING, "Fig. 6"),
    (
        "A7",
        "problems.studies.thrown_ball",
        "Throwing a ball: four policy gradients and their landscapes",
        _SMOOTHING,
        "Fig. 7a and sec. 7.3",
    ),
    (
        "AM",
        "problems.studies.model_learning",
        "A hopper's next state from few transitions",
        _SMOOTHING,
        "Sec. 7, model learning, and eq. 4.1",
    ),
    (
        "AT",
        "problems.studies.convergence_bound",
        "Convergence of policy gradients, beside its bound",
        _SMOOTHING,
        "Thm. 4.2, on the example of fig. 7a",
    ),
    (
        "C1",
        "problems.studies.laws_in_the_loop",
        "Which smoothing to trust in the loop",
        _LINEAR,
        "The question of its title, and what it leaves open",
    ),
    (
        "T1",
        "problems.studies.audited_theory",
        "The theory audited on random contact problems",
        _SMOOTHING,
        "Thm. 4.4, 4.5, 5.1, 5.4, prop. 5.2, 5.3; and lemmas III.1, III.4 of Pathologies",
    ),
)
"""Identifier, module, title, the paper's key and the place in it."""
STUDIES = {
    identifier: FigureStudy(identifier, module, title, Citation(paper, place))
    for identifier, module, title, paper, place in _FIGURES
}
"""In the order of the papers."""


def ids() -> list[str]:
    """Return the identifiers of all studies, in the order of the papers."""
    return list(STUDIES)


def get(name: str) -> FigureStudy:
    """Return the study called ``name``, upper or lower case.

    Raises :class:`~ocp.errors.InputError` for an unknown one.
    """
    identifiers = {identifier.lower(): identifier for identifier in STUDIES}
    return choose("figure", identifiers.get(name.lower(), name), STUDIES)


__all__ = ["Claim", "FigureStudy", "get", "ids"]
