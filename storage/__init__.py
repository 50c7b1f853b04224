"""Recordings in and out: MCAP, importers, results."""
