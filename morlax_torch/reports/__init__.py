"""What evaluations come to: comparisons, tables, and a report."""
