"""DCM, the format in which INCA and others exchange calibrations."""
