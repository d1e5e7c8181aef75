"""Compare methods of integration: error against cost, limits of stability."""
