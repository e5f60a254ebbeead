"""Variables of a model: their sources, and name resolution in masks."""
