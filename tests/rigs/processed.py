"""A processed trial around channels and a crank angle that a test makes itself."""

from sawbench.bench.processed import ProcessedTrial, SteadyPart


def processed_trial(trial, channels, angle, settled_s, end_s):
    """All of the trial is steady, and settled between the two times."""
    return ProcessedTrial(
        trial=trial,
        status="cutting",
        period=None,
        angle=angle,
        phases=(),
        folded={},
        cutting_force=None,
        removed=None,
        peak_force_n=None,
        peak_force_std_n=None,
        channels=channels,
        steady=SteadyPart(
            first_motion_s=float(angle.time_s[0]), start_s=float(angle.time_s[0]), settled_s=settled_s, end_s=end_s
        ),
    )
