"""Converters between battery and motor, and the ways they are driven."""
