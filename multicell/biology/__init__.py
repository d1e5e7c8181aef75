"""Biology of cells: growth, cycle, division, death, adhesion molecules, active forces."""
