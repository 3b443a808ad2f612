"""Compare and report evaluations: tables and an HTML report."""
