"""One fit from one start, and its result."""
