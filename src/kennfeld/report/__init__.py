"""The report: one HTML file that says what a calibration achieved, and how far to trust it."""
