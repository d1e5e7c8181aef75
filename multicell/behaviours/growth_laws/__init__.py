"""Growth laws: the volume of one cell between birth and division."""
