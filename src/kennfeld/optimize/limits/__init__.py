"""Linear limits of the values, and the nearest point that keeps them."""
