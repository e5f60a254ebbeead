"""CVX, INCA's calibration values as CSV."""
