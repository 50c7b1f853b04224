"""The catalogue: one effect a file, listed in `diagnosis.effects.catalogue`."""
