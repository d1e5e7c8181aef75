"""Networks inside cells: reactions as systems of ordinary differential equations."""
