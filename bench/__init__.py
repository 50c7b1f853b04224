"""The words every part of sawbench shares: channels, signals, recordings, configuration, errors."""
