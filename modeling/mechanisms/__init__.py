"""Mechanisms that turn the crank into a stroke."""
