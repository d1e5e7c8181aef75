"""The typed description of a scene."""
