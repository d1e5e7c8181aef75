"""Explanations of a scene before anything is run."""
