"""Wording shared by fits, dose responses and sensitivity analyses."""
