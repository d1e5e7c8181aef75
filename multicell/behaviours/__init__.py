"""What changes what cells do: behaviours, the signals that they respond to, and by which law."""
