"""Programs and their solvers: named blocks, natural units, options and status."""
