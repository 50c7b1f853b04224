"""Rerun, live and replayed: one adapter, and the only user of rerun."""
