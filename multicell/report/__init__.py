"""What people look at: pages, pictures, explanations."""
