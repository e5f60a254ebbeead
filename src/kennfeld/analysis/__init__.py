"""Assessment of a result: its residuals, their location, active limits, and cross-validation."""
