"""Tables, figures and pages of reports; facts about files; export to other programs."""
