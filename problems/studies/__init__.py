"""Studies: one figure of a paper each, one a folder; ``get("P6").data()`` runs one."""

from ocp.errors import choose
from problems.studies.adaptive_mu import study as a1
from problems.studies.audited_theory import study as t1
from problems.studies.barrier_relaxation import study as p6
from problems.studies.bouncing_ball import study as a2
from problems.studies.convergence_bound import study as at
from problems.studies.friction_bias import study as p3
from problems.studies.heaviside_bias import study as p2
from problems.studies.impact_and_friction import study as a6
from problems.studies.interpolated_gradients import study as p7
from problems.studies.jumping_objectives import study as p1
from problems.studies.landing_variance import study as a2v
from problems.studies.model_learning import study as am
from problems.studies.noised_contact import study as n1
from problems.studies.smoothing_ablation import study as a5
from problems.studies.smoothings_compared import study as n3
from problems.studies.start_without_contact import study as n2
from problems.studies.stiff_pushing import study as p5
from problems.studies.study import Claim, Study
from problems.studies.theory_of_noising import study as n0
from problems.studies.thrown_ball import study as a7
from problems.studies.trained_policies import study as a4
from problems.studies.unroll_variance import study as a3
from problems.studies.wall_corner import study as p4

_ALL = (
    *(n0, n1, n2, n3),
    *(p1, p2, p3, p4, p5, p6, p7),
    *(a1, a2, a2v, a3, a4, a5, a6, a7, am, at),
    *(t1,),
)
_STUDIES = {study.id: study for study in _ALL}


def ids() -> list[str]:
    """Identifiers of all studies, in the order of the papers."""
    return list(_STUDIES)


def get(name: str) -> Study:
    """Return the study called ``name``, upper or lower case.

    Raises :class:`~ocp.errors.InputError` for an unknown one.
    """
    known = {identifier.lower(): identifier for identifier in _STUDIES}
    return choose("figure", known.get(name.lower(), name), _STUDIES)


__all__ = ["Claim", "Study", "get", "ids"]
