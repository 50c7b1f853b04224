"""A series of trials: its plan, its journal, how far it is, and whether a trial agrees with its repetitions."""
