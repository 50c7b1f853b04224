"""Sourced parameter sets."""
