"""PDF reports of stored runs: each module has the content and figures of one kind of report."""
