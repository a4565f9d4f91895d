"""The PDF of stored runs: one module per kind of report, with its content for a template and its figures."""
