"""Models of other programs, read and written as scenes."""
