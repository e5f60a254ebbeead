"""Rounding of a calibration to the numbers that a control unit can store, all values together."""
