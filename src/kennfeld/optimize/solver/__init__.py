"""What minimises a sum of squares within linear limits."""
