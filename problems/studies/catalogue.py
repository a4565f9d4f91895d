"""The studies by their identifiers: figures of papers, with what a page says of each."""

from problems.spec import Citation
from problems.studies.study import Study
from problems.studies.trained_policies import study as A4

N0 = Study(
    id="N0",
    title="Theory of noising data",
    citation=Citation("suh2023noising", "lemmas 1 to 3 and sec. IV-C"),
    folder="problems.studies.theory_of_noising",
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
N1 = Study(
    id="N1",
    title="What noised data make of contact along a line",
    citation=Citation("suh2023noising", "Fig. 1, sec. IV-B and IV-C"),
    folder="problems.studies.noised_contact",
    notes=(
        "The paper gives no numbers: the pusher's spring is stiff, so that the slope in contact is"
        " 0.99; data are uniform and random, 10 and 1000 commands, 5 and 1000 states.",
        "In contact the slope is rho = h² K/(m + h² K), not 1.",
        "Networks: two layers, fresh noise in every minibatch; the rms in the legend is of the"
        " network drawn against the average, over the density of the noised data.",
        "What depends on which data were drawn is judged over many sets of them, and networks over"
        " several starts of their weights.",
    ),
)
N2 = Study(
    id="N2",
    title="Pushing and turning from a start without contact",
    citation=Citation("suh2023noising", "Fig. 2 and sec. V-B"),
    folder="problems.studies.start_without_contact",
    notes=(
        "Curves: gains K_t, k_t by Adam through each of the five dynamics; thin on the model, thick"
        " replayed under the exact law, the band the range over seeds of data, networks and noise."
        " Noise is in units of the data's standard deviations; half of the data lie near the line"
        " from start to goal.",
        "Bars: input sequences by IPOPT, the object's part of the cost alone: under the exact law"
        " the actuator still goes to its rest. The average over noise of exact steps has kinks at"
        " which no gradient method can end; its plan is found by direct transcription of the same"
        " average and rolled out.",
        "Adam knows no bound on how far a command may be from the actuator; IPOPT's plans keep it.",
    ),
    resumes=True,
)
N3 = Study(
    id="N3",
    title="Which smoothing to trust",
    citation=Citation("suh2023noising", "Sec. V-B, and what it leaves open"),
    folder="problems.studies.smoothings_compared",
    notes=(
        "In short, at the defaults: plan under the exact law by its default route, or under a sharp"
        " barrier or the adaptive law where few contacts act; trust no gentle barrier and no"
        " randomized plan unreplayed. A learned law is for where no other is known, over several"
        " seeds, and its word on its own plan is worth nothing: only the replay tells. Trust makes"
        " its word truer, mostly by keeping the plan at home.",
        "Every plan is made by direct transcription from the problem's own guess, which is without"
        " contact, and its inputs are replayed under the exact law. An excess is that replay's cost"
        " over the optimum of the exact law by its default route.",
        "Learned laws see transitions drawn in the problem's own region, half of them near the line"
        " from start to goal; widths are in units of the data's standard deviations. The networks"
        " are trained for seconds, not minutes: what is shown is what a quick model is worth.",
        "Trust is solved from the plan without it, to stay near the same local minimum. Its"
        " weight beta is told as a share of what a step costs at rest.",
        "On planar-push and planar-hand the law, exact or not, has the published gaps, linearised"
        " at every step, and the referee the true ones: no plan survives that, the exact law's own"
        " included; what a law is worth there is its replay under the exact law.",
        "Seconds are of the processor, of all its cores together.",
    ),
    resumes=True,
)
P1 = Study(
    id="P1",
    title="Three simple systems with jumps",
    citation=Citation("suh2022pathologies", "Fig. 1 and sec. III-A"),
    folder="problems.studies.jumping_objectives",
    notes=(
        "All three are minimised: minus height, minus squared distance, minus squared angular"
        " velocity.",
        "The authors' code draws panel C from the surrogate -sin²(theta) up to 45 degrees; here the"
        " ball hits a bar, pivoted in its middle, in a plastic frictionless impact.",
    ),
)
P2 = Study(
    id="P2",
    title="Gradient estimates of the Heaviside function",
    citation=Citation("suh2022pathologies", "Fig. 2, example III.2"),
    folder="problems.studies.heaviside_bias",
    notes=(
        "erf(y; s²) in the paper is the upper tail of the Gaussian, not the usual error function.",
        "The mean of the first order's samples does converge, to 0: what fails in ex. III.2 is to"
        " exchange gradient and expectation.",
        "Zero-noise baseline as in the paper's definition, and the mean of the other samples.",
    ),
)
P3 = Study(
    id="P3",
    title="Coulomb friction and empirical bias",
    citation=Citation("suh2022pathologies", "Fig. 3, example III.5"),
    folder="problems.studies.friction_bias",
    notes=(
        "The relaxation is one of the sign, 2 H - 1, not of H.",
        "Ex. III.5 has its gradient zero with probability at least c nu: true for small nu, where"
        " it is zero nearly always, and too little for the triple, which needs 1 - c nu.",
        "The closed form of F in the text is that of neither; the one used here is checked by"
        " quadrature.",
        "Behind it a block of 100 kg dragged from rest by a belt with at most 5 N for 0.1 s.",
    ),
)
P4 = Study(
    id="P4",
    title="A ball against the corner of a wall, and against a dome",
    citation=Citation("suh2022pathologies", "Fig. 4 and example III.6"),
    folder="problems.studies.wall_corner",
    notes=(
        "Impacts are elastic mirror reflections inside a step; the authors' 0.9 of restitution is"
        " declared there, not used. The ground, at y = -0.1 m, is out of reach within the flight.",
        "The dome sits on the wall, its diameter the wall's width.",
    ),
)
P5 = Study(
    id="P5",
    title="Pushing through a stiff spring, and without one",
    citation=Citation("suh2022pathologies", "Fig. 5, example III.7 and sec. IV-A"),
    folder="problems.studies.stiff_pushing",
    notes=(
        "In the authors' code damping is the factor c on the velocity in each step, no dashpot;"
        " with the sweep's own c = 0.1 the curves do not cross. Drawn are the values of their task"
        " runs, with the running cost of fig. 5 alone.",
        "The stability limit follows from the relative motion: stiffness 2 k on mass m.",
        "Variances are traces of the covariance of one sample over all inputs.",
    ),
)
P6 = Study(
    id="P6",
    title="Implicit time stepping and its log-barrier relaxation",
    citation=Citation("suh2022pathologies", "Fig. 6, examples IV.1 and IV.2"),
    folder="problems.studies.barrier_relaxation",
    notes=(
        "The barrier weight and the central-path parameter are one knob: mu = h/kappa for a gap in"
        " position, and lam is an impulse.",
        "The text calls kappa the weight of the barrier; the weight is 1/kappa.",
    ),
)
P7 = Study(
    id="P7",
    title="Interpolated gradients: fooled, and not",
    citation=Citation("suh2022pathologies", "Sec. IV-C, eq. 6, on examples III.2, III.5, III.6"),
    folder="problems.studies.interpolated_gradients",
    notes=(
        "alpha is the weight of the first order here; eq. 6 of the paper has it the other way.",
        "The bound on a single sample's deviation is the largest that the samples show.",
        "The zeroth order has the mean of the other samples as baseline, on its own noise.",
    ),
)
A1 = Study(
    id="A1",
    title="Contact impulse and adaptive mu over the gap, and their noise",
    citation=Citation("zhang2023adaptive", "Fig. 1c and 1d, propositions 5.2 and 5.3"),
    folder="problems.studies.adaptive_mu",
    notes=(
        "mu(z) is the corrected eq. 5.1: kappa = (sigma pdf(z/sigma) - z tail(z/sigma))/F and"
        " mu = kappa (z + F kappa).",
        "The heavy tail of Student's t is the force at a distance of constant mu.",
        "Of the constant mu drawn the caption names 0.1, the others are our choice; its sigma is"
        " not told, so what depends on sigma is judged over a range of it.",
    ),
)
A2 = Study(
    id="A2",
    title="A bouncing ball: elastic as an equation, plastic by time stepping",
    citation=Citation("zhang2023adaptive", "Fig. 2 and C.1"),
    folder="problems.studies.bouncing_ball",
    notes=(
        "mu is that of the force, gamma y = mu; the impulse of one step has h mu. Its values are"
        " our choice, within what C.1 can be integrated at: least height is about exp(-g q0/mu).",
        "The equation conserves energy, so the softened ball bounces back to its height, whatever"
        " mu; the complementarity system of the paper is plastic. Neither is the other's limit:"
        " mu to 0 at fixed h rests on the floor, h to 0 at fixed mu bounces.",
    ),
)
A2V = Study(
    id="A2v",
    title="Gradient variance of a landing ball over mu",
    citation=Citation("zhang2023adaptive", "Sec. 7.2, the figure beside the text"),
    folder="problems.studies.landing_variance",
    notes=(
        "Time stepping is plastic, so no chaos builds up over bounces: after the impact the ball"
        " forgets its height. Variance is largest where the rollout ends near the impact.",
        "mu is that of the impulse, in N s m; positions and velocities weigh one in SI units.",
    ),
)
A3 = Study(
    id="A3",
    title="Gradient variance over the unroll length",
    citation=Citation("zhang2023adaptive", "Fig. 3, sec. 7.2; thm. 4.4"),
    folder="problems.studies.unroll_variance",
    notes=(
        "Every law and length differentiates the same policies from the same states, those of a"
        " training through the adaptive law, so that nothing differs but law and length.",
        "The variance is the trace of the covariance of one unroll's gradient, unrolls that are not"
        " finite left out and counted.",
        "Theorem 4.4 with its constant mended (errata, 28): v = O(H^4 (sqrt 2 L_f L_pi)^(4 H)); L_f"
        " is the largest norm of the step's slopes [A B] among the visited states, L_pi the"
        " policy's, in the states' and inputs' own units.",
    ),
    resumes=True,
    quick={"stages": 2, "unrolls": 64},
)
A5 = Study(
    id="A5",
    title="Which mu to learn through: the half-cheetah",
    citation=Citation("zhang2023adaptive", "Fig. 5, sec. 7.4"),
    folder="problems.studies.smoothing_ablation",
    notes=(
        "All curves are returns of whole episodes of 5 s under the exact law, without noise on the"
        " actions; the paper's axis tells neither law nor noise.",
        "FOPG as ocp train has it for the task, with the plain mean of gradients of eq. 4.2.",
    ),
    resumes=True,
    quick={"runs": 2, "iterations": 30, "judged": 5},
)
A6 = Study(
    id="A6",
    title="Smoothing an impact and smoothing friction",
    citation=Citation("zhang2023adaptive", "Fig. 6"),
    folder="problems.studies.impact_and_friction",
    notes=(
        "RS averages the derivative that exists almost everywhere, as automatic differentiation"
        " gives it; only a sample inside the one step of the impact sees the jump.",
        "The box is problem box-slide: m (v+ - v) = h u + f, |f| <= b = friction h m g by maximal"
        " dissipation, in two pairs; the paper gives no equations.",
        "Costs are counted in solves, at the noise whose bias is the barrier's: an exact solve and"
        " one of the barrier's path take about as long here.",
        "The noise levels and every mu are our choice.",
    ),
)
A7 = Study(
    id="A7",
    title="Throwing a ball: four policy gradients and their landscapes",
    citation=Citation("zhang2023adaptive", "Fig. 7a and sec. 7.3"),
    folder="problems.studies.thrown_ball",
    notes=(
        "The paper gives no numbers: ball, floor and goal are those of the task ball-throw, whose"
        " goal is where 0.6 rad at 3 m/s leads, so that the best return is 0 but for the scheme.",
        "The decision is angle and speed; the paper turns the angle alone.",
        "Every curve is the return of the decision itself, without noise, under the exact law.",
        "All methods have as many samples, the same rate, the same starts and Adam.",
    ),
    quick={"runs": 3, "iterations": 60},
)
AM = Study(
    id="AM",
    title="A hopper's next state from few transitions",
    citation=Citation("zhang2023adaptive", "Sec. 7, model learning, and eq. 4.1"),
    folder="problems.studies.model_learning",
    notes=(
        "The paper names no parameters, ranges or sizes: here four masses, four inertias, friction,"
        " spring and damping of the joints start at random between half and twice the truth.",
        "The model's class holds the truth where data are exact; so each figure stands beside"
        " transitions with noise, and beside a hopper with a drag that the model does not know.",
        "Errors are means over held-out transitions of |x' - f(x, u)|, which adds m, rad, m/s and"
        " rad/s as the paper's does; the search weighs each coordinate by how much it moves.",
        "Intervals: 95 % of the minima of resampled transitions, out to what was found.",
    ),
    resumes=True,
    quick={"seeds": 1, "held": 300, "iterations": 100, "rows": 64, "units": 64, "epochs": 100},
)
AT = Study(
    id="AT",
    title="Convergence of policy gradients, beside its bound",
    citation=Citation("zhang2023adaptive", "Thm. 4.2, on the example of fig. 7a"),
    folder="problems.studies.convergence_bound",
    notes=(
        "J is the mean exact return of the throw under the policy's noise; its gradient, and its"
        " Lipschitz constant L on the window the iterates stay in, come from a fine grid of returns"
        " folded with the noise's density, independent of any estimator.",
        "c = 1/(eta - L eta²) needs eta < 1/L; the theorem's index slips (errata, 27) are mended:"
        " the sum of gains telescopes over all steps taken.",
        "delta is the largest |theta| among the iterates.",
    ),
    quick={"runs": 2, "iterations": 20, "measured": 2000},
)
T1 = Study(
    id="T1",
    title="The theory audited on random contact problems",
    citation=Citation(
        "zhang2023adaptive",
        "Thm. 4.4, 4.5, 5.1, 5.4, prop. 5.2, 5.3; and lemmas III.1, III.4 of Pathologies",
    ),
    folder="problems.studies.audited_theory",
    notes=(
        "Systems: C = D = I, A = B = E = 0, where the bounds are tightest; z standard normal,"
        " mu log-uniform from 1e-8 to 1; F symmetric positive definite, or a P-matrix that is"
        " neither symmetric nor definite. All numbers are without units.",
        "Thm. 4.5 puts a lower bound on l inside an upper bound on the slope, which bounds"
        " nothing; taken as an equality, it is the printed formula, and its sign (A.32) is wrong.",
        "dlam/dz = -(I - D + D F)^-1 D with D in [0, 1]: for a P-matrix the slope is bounded"
        " whatever mu. What grows as mu falls is the curvature, 1/(4 F^1.5 sqrt(mu)).",
    ),
)
_ALL = (
    *(N0, N1, N2, N3),
    *(P1, P2, P3, P4, P5, P6, P7),
    *(A1, A2, A2V, A3, A4, A5, A6, A7, AM, AT),
    *(T1,),
)
STUDIES = {study.id: study for study in _ALL}
"""In the order of the papers."""
