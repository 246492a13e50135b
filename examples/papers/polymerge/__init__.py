"""Claims, tables, figures and verdicts of PolyMerge (arXiv 2606.16232)."""
