"""What four papers claim, judged by our runs: claims, verdicts, tables, figures and pages."""
