"""What is inside a cell: networks of reactions as systems of ordinary differential equations."""
