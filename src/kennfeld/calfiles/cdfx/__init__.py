"""CDFX, the calibration data format of ASAM."""
