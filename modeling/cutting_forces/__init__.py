"""Cutting forces: the paper's linear damper, and a force measured over the crank angle."""
