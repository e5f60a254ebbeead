"""Kennfeld calibrates physics-based sensor models of engine control units."""
