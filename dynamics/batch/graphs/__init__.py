"""The way in: CasADi graphs of a function or a rollout, as tapes that an engine can run."""
