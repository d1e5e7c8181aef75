"""Forces, Jacobian and observables of a population of overdamped cells."""
