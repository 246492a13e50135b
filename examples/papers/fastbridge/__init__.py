"""Claims, tables, figures and verdicts of FastBridge (arXiv 2607.01200)."""
