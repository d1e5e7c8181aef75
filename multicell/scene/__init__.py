"""What there is: the typed description of a scene."""
