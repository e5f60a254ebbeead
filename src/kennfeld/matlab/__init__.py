"""The MATLAB language and its files, as far as models and calibrations need them.

`parser` turns text into the tree of `syntax`, `printing` turns the tree into text again.
"""
