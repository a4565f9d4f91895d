"""Programs and their solvers: named blocks, natural units, and what a solver says."""
