"""The MATLAB language and its data files, as far as models and calibrations need them."""
