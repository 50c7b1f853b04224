"""What the report says: where, how far, which signals, which trial next."""
