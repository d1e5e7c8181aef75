"""Additions of users: laws by their names in a scene, and objects named as `file.py:Name`."""
