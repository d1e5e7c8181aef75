"""What cells do: growth, cycle, division, death, adhesion molecules, active forces."""
