"""Compositions of parts, and parameter sets with a source for every number."""
