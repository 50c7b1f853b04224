"""Causes of simple form that the catalogue does not hold."""
