"""Preparation of recordings: from files and datasets to the samples that a calibration uses."""
