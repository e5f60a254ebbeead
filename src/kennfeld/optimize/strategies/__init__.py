"""Search strategies: smoothing continuation, global search, output limits, free breakpoints."""
