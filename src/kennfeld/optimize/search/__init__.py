"""Ways to the lowest minimum: several starts, sequences of steps, a search without gradients."""
