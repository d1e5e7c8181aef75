"""Wording and confidence shared by fits, dose responses and sensitivity analyses."""
