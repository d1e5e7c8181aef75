"""How the volume of one cell grows between birth and division."""
