"""What fits, dose responses and sensitivity analyses share."""
