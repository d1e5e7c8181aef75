"""Fits of parameters to data: search, emulator, posterior, profile, page."""
