"""What a scene uses and why, before anything is run."""
