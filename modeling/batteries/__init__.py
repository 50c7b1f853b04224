"""Batteries: open-circuit voltage and inner resistance over the state of charge."""
