"""What a model may leave out: one file an effect."""
