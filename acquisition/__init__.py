"""Live instruments: transports, devices, clock, recorder."""
