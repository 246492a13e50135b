"""Claims, tables, figures and verdicts of DR-ACBF (arXiv 2512.00462)."""
