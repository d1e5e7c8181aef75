"""The largest stable step of each method, and how it fails beyond."""
