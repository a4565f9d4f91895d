"""Commands that collect data, fit models of a time step, and train and evaluate policies."""
