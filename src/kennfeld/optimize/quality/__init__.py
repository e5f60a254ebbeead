"""Errors of a model on datasets, by criterion, recording and lookup."""
