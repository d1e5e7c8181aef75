"""What a run leaves: frames, history, lineage, observables, tables."""
