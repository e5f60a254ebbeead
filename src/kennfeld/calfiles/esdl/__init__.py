"""Characteristics of ESDL classes (ASCET)."""
