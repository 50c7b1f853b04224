"""The sim-to-real gap: where it lies, what causes it, how far it shrinks."""
