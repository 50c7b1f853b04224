"""The parts of a machine: each file states the equations of one part once."""
