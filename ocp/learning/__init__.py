"""Algorithms that learn policies, and that learn or identify the models on which policies are trained."""
