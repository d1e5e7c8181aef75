"""Methods that carry positions over a coupling step, one file a family."""
