"""Results of runs: frames, history, lineage, observables, tables."""
