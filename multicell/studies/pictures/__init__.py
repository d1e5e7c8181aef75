"""Pictures of a study, drawn from its table of runs."""
