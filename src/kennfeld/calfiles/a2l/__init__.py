"""A2L, the description of a control unit (ASAM MCD-2 MC, ASAP2): its labels, and their values in an image."""
