"""Types that a calibration is about: parameters, datasets, criteria, constraints."""
