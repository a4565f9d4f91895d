"""N2: does the object move? Planned from a start without contact, under four contact laws."""

from problems.spec import Citation
from problems.studies.study import Study

study = Study(
    id="N2",
    title="Pushing and turning from a start without contact",
    citation=Citation("suh2023noising", "Fig. 2 and sec. V-B"),
    folder=__name__,
    notes=(
        "Only the dynamics f and f_σ of the figure, beside two laws that the paper has not;"
        " IPOPT over input sequences instead of Adam over gains, which are redundant along one"
        " trajectory.",
        "The cost shown is the object's part alone: under the exact law the actuator still goes to"
        " its rest.",
        "The average over noise of exact steps has kinks at which no gradient method can end; its"
        " plan is found by direct transcription of the same average and rolled out.",
    ),
)
