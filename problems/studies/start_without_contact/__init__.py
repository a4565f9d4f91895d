"""N2: does the object move, planned or learned from a start without contact?"""

from problems.spec import Citation
from problems.studies.study import Study

study = Study(
    id="N2",
    title="Pushing and turning from a start without contact",
    citation=Citation("suh2023noising", "Fig. 2 and sec. V-B"),
    folder=__name__,
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
