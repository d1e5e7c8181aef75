"""Reports for people: pages, pictures, explanations."""
