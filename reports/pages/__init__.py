"""One module per kind of report: its content as plain values for a template, and its figures."""
