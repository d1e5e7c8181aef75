"""Laws of the force between two touching cells, one file a law."""
