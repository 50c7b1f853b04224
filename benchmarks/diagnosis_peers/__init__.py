"""Other ways to name the effect, on the cases of the blind check and with the same hypotheses."""
