"""Recordings on their way to a kernel, and their weights."""
