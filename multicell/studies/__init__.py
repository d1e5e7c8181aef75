"""Many runs of one scene: designs, their engine, fits and sensitivities."""
