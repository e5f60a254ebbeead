"""Ways to a minimum: smoothed, global, with output limits, with free breakpoints."""
