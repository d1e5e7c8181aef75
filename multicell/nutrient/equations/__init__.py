"""The fields' equation in py-pde's language, and solvers of py-pde's that this package adds."""
